// The way back of codec.py: whole multiples of a grain, as differences, in gzip, in base64.

const GRAIN = { metre: 0.05, axis: 0.1, radian: 0.02, speed: 0.1 };

function sums(differences, grain, order) {
  let values = differences;
  for (let round = 0; round < order; round += 1) {
    let sum = 0;
    values = values.map((value) => (sum += value));
  }
  return values.map((value) => value * grain);
}

function points(line) {
  const found = [];
  let x = 0;
  let y = 0;
  for (let i = 0; i < line.length; i += 2) {
    x += line[i];
    y += line[i + 1];
    found.push([x * GRAIN.metre, y * GRAIN.metre]);
  }
  return found;
}

async function unpack(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return decodeEpisode(await new Response(stream).json());
}

function decodeEpisode(packed) {
  const lines = (name) => (packed[name] || []).map(points);
  return {
    dt: packed.dt,
    first: packed.first,
    ego: packed.ego,
    hasScene: packed.road !== undefined,
    road: lines("road"),
    offRoad: lines("offRoad"),
    lines: lines("lines"),
    goals: lines("goals"),
    paint: Object.fromEntries(Object.entries(packed.paint || {}).map(([look, found]) => [look, found.map(points)])),
    crosswalks: (packed.crosswalks || []).map(([width, ...line]) => ({ width: width * GRAIN.metre, line: points(line) })),
    stops: lines("stops"),
    signs: (packed.signs || []).map(([rule, x, y, text, unit]) => ({ rule, at: points([x, y])[0], text, unit })),
    lights: (packed.lights || []).map((lamp) => ({ ...lamp, at: points(lamp.at)[0] })),
    users: (packed.users || []).map((user) => ({
      ...user,
      ...decodePath(user),
      outline: user.outline && points(user.outline),
    })),
    predictions: packed.predictions.map(decodePredictions),
    sides: packed.sides.map((side) => side && {
      ...side,
      ...decodePath(side),
      v: sums(side.v, GRAIN.speed, 1),
      place: points(side.place)[0],
      cycles: sums(side.cycles, 1, 1),
      seen: side.seen && decodeSeen(side.seen),
      plans: side.plans.map((column) => column.map((axis) => sums(axis, GRAIN.metre, 2))),
    }),
  };
}

// What the ego saw by cycle: whom it does not know, and [user, [x, y, heading]] of who is elsewhere.
function decodeSeen({ hidden, at }) {
  return {
    hidden: hidden.map((users) => new Set(users)),
    at: at.map((flat) => {
      const found = [];
      for (let i = 0; i < flat.length; i += 4) {
        const [user, x, y, h] = flat.slice(i, i + 4);
        found.push([user, [x * GRAIN.metre, y * GRAIN.metre, h * GRAIN.radian]]);
      }
      return found;
    }),
  };
}

function decodePath(path) {
  return {
    x: sums(path.x, GRAIN.metre, 2),
    y: sums(path.y, GRAIN.metre, 2),
    h: sums(path.h, GRAIN.radian, 1),
  };
}

// Sets by cycle: [user, steps ahead as an index, x, y, first and second semi-axis, angle, weight,
// place among the components of a union].
function decodePredictions(block) {
  const steps = sums(block.steps, 1, 1);
  const cycles = steps.map(() => []);
  for (const run of block.runs) {
    const weights = run.weights ? sums(run.weights, 0.01, 1) : new Array(run.n).fill(1);
    const place = run.component || 0;
    run.sets.forEach((series, ahead) => {
      if (!series.length) return;
      const [x, y] = [0, 1].map((axis) => sums(series[axis], GRAIN.metre, 2));
      const [a, b] = [2, 3].map((axis) => sums(series[axis], GRAIN.axis, 1));
      const angle = sums(series[4], GRAIN.radian, 1);
      for (let i = 0; i < run.n; i += 1) {
        if (a[i] < 0) continue;
        cycles[run.from + i].push([run.user, ahead, x[i], y[i], a[i], b[i], angle[i], weights[i], place]);
      }
    });
  }
  return { offsets: block.offsets, steps, cycles };
}
