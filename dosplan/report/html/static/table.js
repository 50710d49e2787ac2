// The list of scenarios: sorted by a click on a heading, filtered by the form above it.

function element(name, properties = {}) {
  return Object.assign(document.createElement(name), properties);
}

// A scenario; with its future where there are several.
function nameOf(row) {
  return row.future === null ? row.id : `${row.id}, future ${row.future}`;
}

// The cases of each scenario as one line: that of its first case, which knows all of them.
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

function thumbnail(thumb, [width, height]) {
  const picture = svg("svg", { class: "thumb", width, height, viewBox: `0 0 ${width} ${height}`, "aria-hidden": "true" });
  picture.append(svg("path", { class: "road", d: thumb.road }));
  thumb.drives.forEach((drive, index) => {
    if (drive) picture.append(svg("polyline", { class: `side-${index}`, points: drive }));
  });
  return picture;
}

function columnsOf(section, data) {
  const number = (title, value, digits) => ({
    title, value, number: true, cell: (row) => (value(row) === null ? "" : value(row).toFixed(digits)),
  });
  const each = (make) => section.names.map((name, index) => make(name, index));
  const paired = section.names.length > 1;
  return [
    { title: "", cell: (row) => thumbnail(row.thumb, data.thumbnail) },
    { title: "Scenario", value: (row) => row.id, cell: openButton },
    { title: "Road", value: (row) => row.road, cell: (row) => row.road, className: "road" },
    ...each((name, index) => ({
      title: name, side: index, value: (row) => Object.keys(data.outcomes).indexOf(row.sides[index].outcome),
      cell: (row) => (row.future === null ? outcomeBadge(row.sides[index], data) : outcomeSquares(row, index, data)),
    })),
    { title: "Why", value: (row) => whyOf(row, section), cell: (row) => whyOf(row, section), className: "why" },
    ...each((name, index) => ({
      ...number("m/s", (row) => row.sides[index].velocity, 1), side: paired ? index : null, label: `mean velocity ${name}, m/s`,
    })),
    number("TTC, s", (row) => least(row.sides.map((side) => side.ttc)), 1),
    number("p99, ms", (row) => least(row.sides.map((side) => side.p99), -1), 0),
  ];
}

function least(values, sign = 1) {
  const there = values.filter((value) => value !== null);
  return there.length ? sign * Math.min(...there.map((value) => sign * value)) : null;
}

function whyOf(row, section) {
  const paired = section.names.length > 1;
  return row.sides
    .map((side, index) => (side.why && paired ? `${section.names[index]}: ${side.why}` : side.why))
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

// What became of a scenario, in words.
function changeWords(row, names) {
  const words = { fixed: "only {1} succeeded", broken: "only {0} succeeded" }[row.change] || row.change;
  return words.replace(/\{(\d)\}/, (_, side) => names[side]);
}

function changed(row, wanted, faster) {
  const [first, last] = [row.sides[0], row.sides[row.sides.length - 1]];
  const gain = first.velocity === null || last.velocity === null ? 0 : last.velocity - first.velocity;
  const verdicts = {
    "": true,
    differs: row.change === "fixed" || row.change === "broken",
    failed: row.sides.some((side) => side.outcome !== "success"),
    faster: gain >= faster,
    slower: gain <= -faster,
  };
  return wanted in verdicts ? verdicts[wanted] : row.change === wanted;
}

function makeTable(root, section, data, open) {
  const form = root.querySelector("form.filters");
  const head = root.querySelector("table.cases thead");
  const body = root.querySelector("table.cases tbody");
  const columns = columnsOf(section, data);
  const sorting = { column: null, down: false };
  const folded = foldFutures(section.cases);
  let shown = folded;

  const alone = ["", "failed"];
  const choices = section.names.length > 1 ? CHANGES : CHANGES.filter(([key]) => alone.includes(key));
  form.elements.change.replaceChildren(...choices.map(([value, text]) => element("option", {
    value, textContent: text.replace(/\{(\d)\}/, (_, side) => section.names[side]),
  })));

  const headings = element("tr");
  columns.forEach((column, index) => {
    const cell = element("th", { scope: "col" });
    if (column.value) {
      const button = element("button", { type: "button", textContent: column.title });
      if (column.label) button.title = column.label;
      if (column.side !== undefined && column.side !== null) {
        button.prepend(element("i", { className: `key side-${column.side}` }));
      }
      button.addEventListener("click", () => {
        sorting.down = sorting.column === index && !sorting.down;
        sorting.column = index;
        show();
      });
      cell.append(button);
    }
    headings.append(cell);
  });
  head.replaceChildren(headings);

  // The arrows of the player lead through all futures of what is listed.
  function play(row) {
    const list = shown.flatMap((line) => line.futures);
    if (row.episode) open(list, list.indexOf(row), section.names);
  }

  const lines = new Map(folded.map((row) => {
    const line = element("tr");
    columns.forEach((column) => {
      const cell = element("td", { className: column.number ? "number" : column.className || "" });
      cell.append(column.cell(row));
      line.append(cell);
    });
    line.addEventListener("click", ({ target }) => {
      const square = target.closest("[data-future]");
      play(square ? row.futures.find((one) => one.future === Number(square.dataset.future)) : row);
    });
    return [row, line];
  }));

  function keeps(row) {
    const text = form.elements.text.value.trim().toLowerCase();
    const words = [row.id, row.family, row.road, whyOf(row, section)].join(" ").toLowerCase();
    return words.includes(text) && changed(row, form.elements.change.value, data.faster)
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
    [...headings.children].forEach((cell, index) => {
      if (index === sorting.column) cell.setAttribute("aria-sort", sorting.down ? "descending" : "ascending");
      else cell.removeAttribute("aria-sort");
    });
    body.replaceChildren(...shown.map((row) => lines.get(row)));
    form.querySelector("output").textContent = `${shown.length} of ${folded.length}`;
  }

  // Ways from the result and from a group to their scenarios; they clear what was asked for before.
  for (const name of ["change", "text"]) {
    root.querySelectorAll(`[data-${name}]`).forEach((button) => button.addEventListener("click", () => {
      form.reset();
      form.elements[name].value = button.dataset[name];
      show();
      root.querySelector(".list").scrollIntoView();
      form.elements[name].focus({ preventScroll: true });
    }));
  }
  form.addEventListener("input", show);
  form.addEventListener("submit", (event) => event.preventDefault());
  show();
}
