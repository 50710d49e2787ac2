"""A trained trajectory network: where every road user will be in the next four seconds."""
