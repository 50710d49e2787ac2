// Drawing a moment of an episode on a canvas: metres in, pixels out; y points up in the scene.

function poseAt(path, step, start) {
  const last = path.x.length - 1;
  const at = Math.min(Math.max(step - start, 0), last);
  const i = Math.min(Math.floor(at), Math.max(last - 1, 0));
  const part = last === 0 ? 0 : at - i;
  const mix = (values) => values[i] + part * (values[Math.min(i + 1, last)] - values[i]);
  return [mix(path.x), mix(path.y), mix(path.h)];
}

function latest(steps, step) {
  let found = -1;
  while (found + 1 < steps.length && steps[found + 1] <= step + 1e-6) found += 1;
  return found;
}

function drawScene(context, size, view, episode, step, layers, palette) {
  const ratio = size.ratio;
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.fillStyle = palette.land;
  context.fillRect(0, 0, size.width * ratio, size.height * ratio);
  const scale = view.scale * ratio;
  context.setTransform(
    scale, 0, 0, -scale,
    (size.width * ratio) / 2 - view.x * scale, (size.height * ratio) / 2 + view.y * scale,
  );
  const pixel = 1 / view.scale;
  drawRoad(context, episode, pixel, palette);
  if (layers.rules) episode.signs.forEach((sign) => drawSign(context, sign, pixel, palette));
  if (layers.sets) drawSets(context, episode, step, layers, pixel, palette);
  episode.users.forEach((user, index) => {
    // A road user that reacts was driven once for each side.
    const shown = episode.sides.filter((side, i) => side && layers.sides[i] && (!user.sides || user.sides.includes(i)));
    if (user.sides && !shown.length) return;
    // Faint: none of the shown sides knows of it at this step.
    context.globalAlpha = shown.length && shown.every((side) => isHidden(side, index, step)) ? 0.25 : 1;
    drawUser(context, user, step, shown.some((side) => side.touched === user.id), pixel, palette);
    context.globalAlpha = 1;
  });
  episode.sides.forEach((side, index) => {
    if (side && layers.sides[index]) drawSide(context, episode, side, index, step, layers, pixel, palette);
  });
  // Whom an ego meets is not hidden by it.
  episode.sides.forEach((side, index) => {
    if (!side || !layers.sides[index] || step - side.start < side.moment) return;
    episode.users
      .filter((user) => user.id === side.touched && (!user.sides || user.sides.includes(index)))
      .forEach((user) => drawUser(context, user, step, true, pixel, palette));
  });
  if (layers.rules) {
    // Above the bodies: whoever drives over a stop line does not hide its light.
    episode.lights
      .filter((lamp) => !lamp.sides || lamp.sides.some((side) => layers.sides[side]))
      .forEach((lamp) => drawLamp(context, lamp, step, pixel, palette));
  }
  drawBar(context, size, view, palette);
}

function trace(context, line) {
  line.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
}

function drawRoad(context, episode, pixel, palette) {
  // Lanelets that are no road for a car: outlined, in a shade between land and road.
  context.beginPath();
  episode.offRoad.forEach((ring) => { trace(context, ring); context.closePath(); });
  context.fillStyle = palette.offRoad;
  context.fill("evenodd");
  context.setLineDash([4 * pixel, 3 * pixel]);
  context.strokeStyle = palette.faint;
  context.lineWidth = pixel;
  context.stroke();
  context.setLineDash([]);
  context.beginPath();
  episode.road.forEach((ring) => { trace(context, ring); context.closePath(); });
  context.fillStyle = palette.road;
  context.fill("evenodd");
  drawPaint(context, episode, pixel, palette);
  context.beginPath();
  episode.goals.forEach((ring) => { trace(context, ring); context.closePath(); });
  context.fillStyle = palette.goal;
  context.globalAlpha = 0.28;
  context.fill("evenodd");
  context.globalAlpha = 1;
  context.strokeStyle = palette.goal;
  context.lineWidth = 1.5 * pixel;
  context.stroke();
}

// Width in metres and in pixels, whichever is more, and dashes in metres, of each kind of line.
const LOOKS = [
  ["kerb", 0.15, 1, []], ["dashed", 0.15, 1.4, [3, 3]], ["broadDashed", 0.3, 2.6, [3, 3]],
  ["solid", 0.15, 1.4, []], ["broadSolid", 0.3, 2.6, []],
];

function drawPaint(context, episode, pixel, palette) {
  const draw = (found, colour, width, dashes = []) => {
    context.beginPath();
    found.forEach((line) => trace(context, line));
    context.setLineDash(dashes);
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.stroke();
    context.setLineDash([]);
  };
  context.lineCap = "butt";
  draw(episode.lines, palette.marking, Math.max(0.08, pixel));
  LOOKS.forEach(([look, metres, pixels, dashes]) => {
    draw(episode.paint[look] || [], look === "kerb" ? palette.kerb : palette.paint, Math.max(metres, pixels * pixel), dashes);
  });
  // A broad stroke in short dashes: the stripes lie across the pedestrians' way.
  episode.crosswalks.forEach(({ width, line }) => draw([line], palette.paint, width, [0.5, 0.5]));
  draw(episode.stops, palette.paint, Math.max(0.4, 2.6 * pixel));
}

function drawLamp(context, lamp, step, pixel, palette) {
  const [disc, core] = palette.lamps[lamp.shown[Math.max(latest(lamp.from, step), 0)]];
  for (const [colour, radius] of [[palette.signs.rim, 6], [disc, 4.4], [core, 2.2]]) {
    context.beginPath();
    context.arc(...lamp.at, radius * pixel, 0, 2 * Math.PI);
    context.fillStyle = colour;
    context.fill();
  }
}

// Corners of a sign in pixels from its middle, y down; a speed limit is a circle.
const SHAPES = {
  stop: [-3, -1, 1, 3, 5, 7, 9, 11].map((i) => [8 * Math.cos((i * Math.PI) / 8), 8 * Math.sin((i * Math.PI) / 8)]),
  give_way: [[-8, -6], [8, -6], [0, 8]],
  priority: [[0, -7.5], [7.5, 0], [0, 7.5], [-7.5, 0]],
};

function drawSign(context, sign, pixel, palette) {
  const { red, yellow, rim } = palette.signs;
  context.save();
  context.translate(...sign.at);
  context.scale(pixel, -pixel);
  context.beginPath();
  if (SHAPES[sign.rule]) {
    trace(context, SHAPES[sign.rule]);
    context.closePath();
  } else {
    context.arc(0, 0, 8, 0, 2 * Math.PI);
  }
  context.fillStyle = { stop: red, priority: yellow }[sign.rule] || "#ffffff";
  context.strokeStyle = { stop: "#ffffff", priority: "#ffffff" }[sign.rule] || red;
  context.lineWidth = sign.rule === "give_way" || sign.text ? 2.2 : 1.2;
  context.lineJoin = "round";
  context.fill();
  context.stroke();
  if (sign.text) {
    context.font = `bold ${sign.text.length > 2 ? 7 : 8.5}px system-ui, sans-serif`;
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.fillStyle = rim;
    context.fillText(sign.text, 0, 0.5);
  }
  context.restore();
}

function drawSets(context, episode, step, layers, pixel, palette) {
  const drawn = new Set();
  episode.sides.forEach((side, index) => {
    if (!side || !side.predictions || !layers.sides[index]) return;
    const { block, points: asPoints } = side.predictions;
    const name = `${block} ${asPoints}`;
    if (drawn.has(name)) return;
    drawn.add(name);
    const predictions = episode.predictions[block];
    const cycle = latest(predictions.steps, step);
    if (cycle < 0) return;
    const sets = predictions.cycles[cycle].slice().sort((p, q) => q[1] - p[1]);
    for (const [, ahead, x, y, a, b, angle, weight, place] of sets) {
      if (asPoints && place > 0) continue; // Without sets, the most likely component is left.
      const share = ahead / Math.max(predictions.offsets.length - 1, 1);
      const colour = ramp(palette, share);
      context.beginPath();
      if (asPoints || a <= 0) {
        context.arc(x, y, 2.2 * pixel, 0, 2 * Math.PI);
        context.fillStyle = colour;
        context.fill();
      } else {
        context.ellipse(x, y, a, b, angle, 0, 2 * Math.PI);
        context.fillStyle = colour;
        const opacity = Math.sqrt(weight); // A component of little weight matters, too.
        context.globalAlpha = 0.16 * opacity;
        context.fill();
        context.globalAlpha = 0.9 * opacity;
        context.strokeStyle = colour;
        context.lineWidth = pixel;
        context.stroke();
        context.globalAlpha = 1;
      }
    }
  });
}

// Traces a body in its own frame, which holds until the next restore().
function traceBody(context, [x, y, heading], length, width, outline) {
  context.save();
  context.translate(x, y);
  context.rotate(heading);
  context.beginPath();
  trace(context, outline || [[1, 1], [-1, 1], [-1, -1], [1, -1]].map(([a, b]) => [(a * length) / 2, (b * width) / 2]));
  context.closePath();
}

function drawBody(context, pose, length, width, outline, fill, edge, lineWidth) {
  traceBody(context, pose, length, width, outline);
  context.fillStyle = fill;
  context.fill();
  context.strokeStyle = edge;
  context.lineWidth = lineWidth;
  context.stroke();
  context.beginPath();
  trace(context, [[0.46 * length, 0], [0.18 * length, 0.36 * width], [0.18 * length, -0.36 * width]]);
  context.closePath();
  context.fillStyle = "rgb(255 255 255 / 80%)";
  context.fill();
  context.restore();
}

function isHidden(side, user, step) {
  const cycle = side.seen ? latest(side.cycles, step) : -1;
  return cycle >= 0 && side.seen.hidden[cycle].has(user);
}

// A body where it is not now: a broken outline.
function drawGhost(context, pose, length, width, outline, colour, dash, pixel) {
  traceBody(context, pose, length, width, outline);
  context.setLineDash(dash.map((pixels) => pixels * pixel));
  context.strokeStyle = colour;
  context.lineWidth = 1.5 * pixel;
  context.stroke();
  context.restore();
}

function drawUser(context, user, step, touched, pixel, palette) {
  if (step < user.from || step > user.to) return;
  const edge = touched ? palette.outcomes.collision : palette.ink;
  const [length, width] = user.size;
  drawBody(
    context, poseAt(user, step, user.from), length, width, user.outline,
    palette.kinds[user.kind], edge, (touched ? 3 : 0.7) * pixel,
  );
}

function drawSide(context, episode, side, index, step, layers, pixel, palette) {
  const colour = palette.sides[index];
  const at = Math.min(Math.max(step - side.start, 0), side.x.length - 1);
  const whole = Math.floor(at);
  const pose = poseAt(side, step, side.start);
  context.lineCap = "round";
  context.lineJoin = "round";
  drawGhost(context, [side.x[0], side.y[0], side.h[0]], episode.ego[0], episode.ego[1], null, colour, [5, 3], pixel);
  const cycle = side.seen ? latest(side.cycles, step) : -1;
  (cycle < 0 ? [] : side.seen.at[cycle]).forEach(([user, at]) => {
    const { size, outline } = episode.users[user];
    drawGhost(context, at, size[0], size[1], outline, colour, [1.5, 2], pixel);
  });
  if (layers.path) {
    context.beginPath();
    context.globalAlpha = 0.3;
    trace(context, side.x.map((x, i) => [x, side.y[i]]));
    context.strokeStyle = colour;
    context.lineWidth = 1.5 * pixel;
    context.stroke();
    context.globalAlpha = 1;
    context.beginPath();
    trace(context, [...side.x.slice(0, whole + 1).map((x, i) => [x, side.y[i]]), pose]);
    context.lineWidth = 3 * pixel;
    context.stroke();
  }
  if (layers.plan && step - side.start < side.x.length - 1) drawPlan(context, side, step, pose, colour, pixel);
  drawBody(context, pose, episode.ego[0], episode.ego[1], null, colour, palette.ink, 1.6 * pixel);
  if (step - side.start >= side.moment) drawMoment(context, side, colour, pixel, palette);
}

function drawPlan(context, side, step, pose, colour, pixel) {
  const cycle = latest(side.cycles, step);
  if (cycle < 0) return;
  context.beginPath();
  trace(context, [pose, ...side.plans.map(([x, y]) => [x[cycle], y[cycle]])]);
  context.setLineDash([5 * pixel, 4 * pixel]);
  context.strokeStyle = colour;
  context.lineWidth = 2 * pixel;
  context.stroke();
  context.setLineDash([]);
  side.plans.forEach(([x, y]) => {
    context.beginPath();
    context.arc(x[cycle], y[cycle], 2.5 * pixel, 0, 2 * Math.PI);
    context.fillStyle = colour;
    context.fill();
  });
}

// Where and how it ended: a cross for what went wrong, open where the contact is; a ring for a goal.
function drawMoment(context, side, colour, pixel, palette) {
  const [x, y] = side.place;
  const good = side.outcome === "success";
  const [inner, reach] = [14 * pixel, 23 * pixel];
  for (const [style, width] of [[palette.paper, 7], [good ? palette.outcomes.success : palette.outcomes[side.outcome], 3.5]]) {
    context.beginPath();
    if (good) {
      context.arc(x, y, 16 * pixel, 0, 2 * Math.PI);
    } else {
      for (const [across, up] of [[-1, -1], [-1, 1], [1, -1], [1, 1]]) {
        context.moveTo(x + across * inner, y + up * inner);
        context.lineTo(x + across * reach, y + up * reach);
      }
    }
    context.strokeStyle = style;
    context.lineWidth = width * pixel;
    context.stroke();
  }
}

function drawBar(context, size, view, palette) {
  const metres = [5, 10, 20, 50, 100].find((length) => length * view.scale > 60) || 100;
  context.setTransform(size.ratio, 0, 0, size.ratio, 0, 0);
  context.strokeStyle = palette.ink;
  context.fillStyle = palette.ink;
  context.lineWidth = 2;
  context.beginPath();
  trace(context, [[14, size.height - 14], [14 + metres * view.scale, size.height - 14]]);
  context.stroke();
  context.font = "12px system-ui, sans-serif";
  context.fillText(`${metres} m`, 14, size.height - 20);
}

function drawSpeeds(context, size, episode, listed, step, palette, span) {
  const ratio = size.ratio;
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, size.width, size.height);
  const fastest = Math.max(5, ...listed.flatMap((side) => side.v));
  const left = 26;
  const x = (at) => left + ((at - episode.first) / Math.max(span, 1)) * (size.width - left - 4);
  const y = (v) => size.height - 16 - (v / fastest) * (size.height - 26);
  context.font = "11px system-ui, sans-serif";
  context.fillStyle = palette.faint;
  context.strokeStyle = palette.line;
  context.lineWidth = 1;
  for (const v of [0, fastest]) {
    context.beginPath();
    trace(context, [[left, y(v)], [size.width - 4, y(v)]]);
    context.stroke();
    context.fillText(v.toFixed(0), 4, y(v) + 4);
  }
  context.fillText("velocity, m/s", left, size.height - 3);
  episode.sides.forEach((side, index) => {
    if (!listed.includes(side)) return;
    context.beginPath();
    trace(context, side.v.map((v, i) => [x(side.start + i), y(v)]));
    context.strokeStyle = palette.sides[index];
    context.lineWidth = 1.8;
    context.stroke();
  });
  context.beginPath();
  trace(context, [[x(step), 4], [x(step), size.height - 16]]);
  context.strokeStyle = palette.ink;
  context.lineWidth = 1;
  context.stroke();
}

function ramp(palette, share) {
  const [low, high, part] = share < 0.5
    ? [palette.near, palette.middle, 2 * share] : [palette.middle, palette.far, 2 * share - 1];
  const mixed = low.map((value, i) => Math.round(value + part * (high[i] - value)));
  return `rgb(${mixed.join(" ")})`;
}
