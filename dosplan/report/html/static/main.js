// Puts the page together.

const data = JSON.parse(document.getElementById("data").textContent);
const player = makePlayer(document.getElementById("player"), data);
const sections = [...document.querySelectorAll(".section")].map((root, index) => {
  const section = data.sections[index];
  section.view = section.views[0]; // Which sides are looked at.
  return { ...section, ...makeSection(root, section, data, player.open) };
});

const root = document.documentElement;
const dark = matchMedia("(prefers-color-scheme: dark)");
function setTheme(theme) {
  root.dataset.theme = theme;
  player.draw();
}
setTheme(dark.matches ? "dark" : "light");
dark.addEventListener("change", () => setTheme(dark.matches ? "dark" : "light"));
document.getElementById("theme").addEventListener("click", () => {
  setTheme(root.dataset.theme === "dark" ? "light" : "dark");
});

// A link to an episode: report.html#SCENARIO, or #SCENARIO, future K.
function openLinked() {
  const wanted = decodeURIComponent(location.hash.slice(1));
  for (const section of sections) {
    const played = (test) => section.cases.findIndex((row) => row.episode && test(row));
    const named = played((row) => nameOf(row) === wanted);
    const index = named >= 0 ? named : played((row) => row.id === wanted);
    if (index >= 0) {
      section.play(section.cases[index], section.cases);
      return;
    }
  }
}
addEventListener("hashchange", openLinked);
openLinked();
