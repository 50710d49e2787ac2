"""Where scenario files come from: folders, archives, URLs and lists."""
