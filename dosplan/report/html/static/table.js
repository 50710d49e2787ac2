// The sides that are looked at, and the list of scenarios: sorted by a click on a heading, filtered
// by the form above it. A view is the indices of two sides, or of the only one.

function element(name, properties = {}) {
  return Object.assign(document.createElement(name), properties);
}

// A scenario; with its future where there are several.
function nameOf(row) {
  return row.future === null ? row.id : `${row.id}, future ${row.future}`;
}

// The cases of each scenario as one line: that of its most urgent case, which knows all of them.
function foldFutures(cases) {
  const lines = new Map();
  cases.forEach((row) => {
    if (!lines.has(row.id)) lines.set(row.id, Object.assign(row, { futures: [] }));
    lines.get(row.id).futures.push(row);
  });
  lines.forEach((row) => row.futures.sort((a, b) => a.future - b.future));
  return [...lines.values()];
}

// A square for each future of a scenario, in the colour of its outcome, which opens it.
function outcomeSquares(line, side, data) {
  const squares = element("span", { className: "futures" });
  squares.append(...line.futures.map((row) => {
    const { outcome, fault } = row.sides[side];
    const title = `future ${row.future}: ${data.outcomes[outcome]}${fault ? ", at fault" : ""}`;
    const square = element("button", { type: "button", title, disabled: !row.episode });
    square.append(element("i", { className: outcome }));
    square.setAttribute("aria-label", title);
    square.dataset.future = row.future;
    return square;
  }));
  return squares;
}

function sideKey(side) {
  const key = element("i", { className: "key" });
  key.style.setProperty("--side", `var(--side-${side})`);
  return key;
}

function outcomeBadge(side, data) {
  const badge = element("span", { className: "outcome" });
  badge.append(element("i", { className: side.outcome }), data.outcomes[side.outcome]);
  if (side.fault) badge.append(", at fault");
  return badge;
}

function svg(name, attributes) {
  const node = document.createElementNS("http://www.w3.org/2000/svg", name);
  Object.entries(attributes).forEach(([key, value]) => node.setAttribute(key, value));
  return node;
}

function sideStyle(side) {
  return `--side: var(--side-${side})`;
}

function thumbnail(thumb, [width, height], view) {
  const picture = svg("svg", { class: "thumb", width, height, viewBox: `0 0 ${width} ${height}`, "aria-hidden": "true" });
  picture.append(svg("path", { class: "road", d: thumb.road }));
  view.forEach((side, index) => {
    const drive = thumb.drives[side];
    if (drive) picture.append(svg("polyline", { ...(index ? { class: "second" } : {}), style: sideStyle(side), points: drive }));
  });
  return picture;
}

function columnsOf(section, data) {
  const number = (title, value, digits) => ({
    title, value, number: true, cell: (row) => (value(row) === null ? "" : value(row).toFixed(digits)),
  });
  const each = (make) => section.view.map((side) => make(section.names[side], side));
  const paired = section.view.length > 1;
  const shown = (row) => section.view.map((side) => row.sides[side]);
  return [
    { title: "", cell: (row) => thumbnail(row.thumb, data.thumbnail, section.view), className: "picture" },
    { title: "Scenario", value: (row) => row.id, cell: openButton, className: "name" },
    { title: "Road", value: (row) => row.road, cell: (row) => row.road, className: "road" },
    ...each((name, index) => ({
      title: name, side: index, label: name, className: "outcomes", value: (row) => Object.keys(data.outcomes).indexOf(row.sides[index].outcome),
      cell: (row) => (row.future === null ? outcomeBadge(row.sides[index], data) : outcomeSquares(row, index, data)),
    })),
    { title: "Why", value: (row) => whyOf(row, section), cell: (row) => whyOf(row, section), className: "why" },
    ...each((name, index) => ({
      ...number("m/s", (row) => row.sides[index].velocity, 1), side: paired ? index : null, label: `mean velocity ${name}, m/s`,
    })),
    number("TTC, s", (row) => least(shown(row).map((side) => side.ttc)), 1),
    number("p99, ms", (row) => least(shown(row).map((side) => side.p99), -1), 0),
  ];
}

function least(values, sign = 1) {
  const there = values.filter((value) => value !== null);
  return there.length ? sign * Math.min(...there.map((value) => sign * value)) : null;
}

function whyOf(row, section) {
  const paired = section.view.length > 1;
  return section.view
    .map((side) => [section.names[side], row.sides[side].why])
    .map(([name, why]) => (why && paired ? `${name}: ${why}` : why))
    .filter(Boolean).join("\n");
}

function openButton(row) {
  return row.episode
    ? element("button", { type: "button", className: "open", textContent: row.id })
    : element("span", { textContent: row.id, title: "There is no recording of it in this page." });
}

const CHANGES = [
  ["", "all scenarios"],
  ["differs", "success differs"],
  ["fixed", "fixed: only {1} succeeded"],
  ["broken", "broken: only {0} succeeded"],
  ["both failed", "both failed"],
  ["failed", "any failure"],
  ["faster", "faster: {1}"],
  ["slower", "slower: {1}"],
];

const URGENT = ["fixed", "broken", "both failed", "failed", "both succeeded", "succeeded"];

// What the second side of a view changed; see change_of in cases.py.
function changeOf(row, view) {
  const reached = view.map((side) => row.sides[side].outcome === "success");
  if (reached.length === 1) return reached[0] ? "succeeded" : "failed";
  if (reached[0] === reached[1]) return reached[0] ? "both succeeded" : "both failed";
  return reached[1] ? "fixed" : "broken";
}

function named(words, section) {
  return words.replace(/\{(\d)\}/, (_, index) => section.names[section.view[index]]);
}

// What became of a scenario, in words.
function changeWords(row, section) {
  const change = changeOf(row, section.view);
  return named({ fixed: "only {1} succeeded", broken: "only {0} succeeded" }[change] || change, section);
}

function changed(row, wanted, faster, view) {
  const sides = view.map((side) => row.sides[side]);
  const [first, last] = [sides[0], sides[sides.length - 1]];
  const change = changeOf(row, view);
  const gain = first.velocity === null || last.velocity === null ? 0 : last.velocity - first.velocity;
  const verdicts = {
    "": true,
    differs: change === "fixed" || change === "broken",
    failed: sides.some((side) => side.outcome !== "success"),
    faster: gain >= faster,
    slower: gain <= -faster,
  };
  return wanted in verdicts ? verdicts[wanted] : change === wanted;
}

function makeSection(root, section, data, open) {
  const form = root.querySelector("form.filters");
  const head = root.querySelector("table.cases thead");
  const body = root.querySelector("table.cases tbody");
  const chooser = root.querySelector("select[name=view]");
  const sorting = { column: null, down: false };
  let columns = [];
  let headings = [];
  let folded = [];
  let lines = new Map();
  let shown = [];

  // Shows two sides, or the only one: what of the page is of others is hidden.
  function look(view) {
    section.view = view;
    root.querySelectorAll("[data-side]").forEach((node) => { node.hidden = !view.includes(Number(node.dataset.side)); });
    root.querySelectorAll("[data-view]").forEach((node) => { node.hidden = node.dataset.view !== view.join("-"); });
    section.names.forEach((_, side) => { if (!view.includes(side)) form.elements[`outcome-${side}`].value = ""; });
    const wanted = form.elements.change.value;
    const alone = ["", "failed"];
    const choices = view.length > 1 ? CHANGES : CHANGES.filter(([key]) => alone.includes(key));
    form.elements.change.replaceChildren(...choices.map(([value, text]) => element("option", {
      value, textContent: named(text, section),
    })));
    form.elements.change.value = wanted;
    const urgency = (row) => URGENT.indexOf(changeOf(row, view));
    folded = foldFutures([...section.cases].sort((a, b) => urgency(a) - urgency(b)));
    columns = columnsOf(section, data);
    headings = columns.map(heading);
    const line = element("tr");
    line.append(...headings);
    head.replaceChildren(line);
    lines = new Map(folded.map((row) => [row, lineOf(row)]));
    show();
  }

  function heading(column, index) {
    const cell = element("th", { scope: "col" });
    if (!column.value) return cell;
    const button = element("button", { type: "button", textContent: column.title });
    if (column.label) button.title = column.label;
    if (column.side !== undefined && column.side !== null) button.prepend(sideKey(column.side));
    button.addEventListener("click", () => {
      sorting.down = sorting.column === index && !sorting.down;
      sorting.column = index;
      show();
    });
    cell.append(button);
    return cell;
  }

  // The arrows of the player lead through all futures of what is listed.
  function play(row, list = shown.flatMap((line) => line.futures)) {
    if (row.episode) open(list, list.indexOf(row), section);
  }

  function lineOf(row) {
    const line = element("tr");
    columns.forEach((column) => {
      const cell = element("td", { className: column.number ? "number" : column.className || "" });
      cell.dataset.title = column.title; // Shown where there are no columns.
      if (column.side !== undefined && column.side !== null) cell.append(sideKey(column.side));
      cell.append(column.cell(row));
      line.append(cell);
    });
    line.addEventListener("click", ({ target }) => {
      const square = target.closest("[data-future]");
      play(square ? row.futures.find((one) => one.future === Number(square.dataset.future)) : row);
    });
    return line;
  }

  function keeps(row) {
    const text = form.elements.text.value.trim().toLowerCase();
    const words = [row.id, row.family, row.road, whyOf(row, section)].join(" ").toLowerCase();
    return words.includes(text) && changed(row, form.elements.change.value, data.faster, section.view)
      && row.sides.every((side, index) => {
        const wanted = form.elements[`outcome-${index}`].value;
        return !wanted || wanted === side.outcome;
      });
  }

  function show() {
    shown = folded.filter((line) => line.futures.some(keeps));
    if (sorting.column !== null) {
      const { value } = columns[sorting.column];
      const sign = sorting.down ? -1 : 1;
      shown.sort((a, b) => {
        const [p, q] = [value(a), value(b)];
        if (p === null || q === null) return (p === null) - (q === null); // Unknown ones come last.
        return sign * (typeof p === "string" ? p.localeCompare(q, "en", { numeric: true }) : p - q);
      });
    }
    headings.forEach((cell, index) => {
      if (index === sorting.column) cell.setAttribute("aria-sort", sorting.down ? "descending" : "ascending");
      else cell.removeAttribute("aria-sort");
    });
    body.replaceChildren(...shown.map((row) => lines.get(row)));
    form.querySelector("output").textContent = `${shown.length} of ${folded.length}`;
  }

  // Ways from the result and from a group to their scenarios; they clear what was asked for before.
  for (const name of ["change", "text"]) {
    root.querySelectorAll(`button[data-${name}]`).forEach((button) => button.addEventListener("click", () => {
      form.reset();
      form.elements[name].value = button.dataset[name];
      show();
      root.querySelector(".list").scrollIntoView();
      form.elements[name].focus({ preventScroll: true });
    }));
  }
  form.addEventListener("input", show);
  form.addEventListener("submit", (event) => event.preventDefault());
  if (chooser) {
    const choose = () => look(chooser.value.split("-").map(Number));
    chooser.addEventListener("change", choose);
    choose(); // A browser may have kept the choice over a reload.
  } else {
    look(section.view);
  }
  return { play };
}
