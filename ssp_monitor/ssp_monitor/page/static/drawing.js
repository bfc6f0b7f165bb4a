// How the map is drawn: lines of the site, objects as boxes to scale, the scale itself.

const SHOWN_BOX_PX = 9; // an object that would be smaller is drawn this long all the same
const NAMES = ["back", "text", "quiet", "vut", "ot", "traffic", "fence", "zone", "road", "edge",
  "mark", "bad", "abort", "ready", "panel"];

export function colours() {
  const style = getComputedStyle(document.documentElement);
  return Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

function roleColour(role, paint) {
  return { VUT: paint.vut, OT: paint.ot }[role] ?? paint.traffic;
}

function trace(context, view, points, close) {
  context.beginPath();
  points.forEach(([x, y], index) => {
    const [px, py] = view.toScreen(x, y);
    if (index) context.lineTo(px, py);
    else context.moveTo(px, py);
  });
  if (close) context.closePath();
}

function stroke(context, colour, width, dash = []) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.setLineDash(dash);
  context.stroke();
  context.setLineDash([]);
}

// -- what stands still ---------------------------------------------------------------------------

export function drawSite(context, view, site, paint) {
  drawRoad(context, view, site, paint);
  for (const region of site.regions) {
    trace(context, view, region.points, true);
    stroke(context, paint.quiet, 1.5, [2, 4]);
    label(context, view, region.points[0], region.name, paint.quiet);
  }
  for (const zone of site.zones) {
    trace(context, view, zone.points, true);
    context.globalAlpha = 0.4;
    context.fillStyle = paint.zone;
    context.fill();
    context.globalAlpha = 1;
    stroke(context, paint.zone, 2.5);
  }
  for (const route of site.routes) {
    trace(context, view, route.points, false);
    context.globalAlpha = 0.6;
    stroke(context, roleColour(route.role, paint), 1.5, route.purpose === "approach" ? [] : [9, 6]);
    context.globalAlpha = 1;
  }
  for (const start of site.starts) {
    const [px, py] = view.toScreen(...start.at);
    context.beginPath();
    context.arc(px, py, Math.max(start.radius * view.scale, 3), 0, 2 * Math.PI);
    stroke(context, roleColour(start.role, paint), 1.5, [3, 3]);
  }
  for (const anchor of site.anchors) drawAnchor(context, view, anchor, paint);
  trace(context, view, site.fence, true);
  stroke(context, paint.fence, 2.5, [12, 5, 3, 5]);
}

function drawRoad(context, view, site, paint) {
  const edges = site.lines.filter((line) => line.kind === "edge");
  if (edges.length === 2) {
    trace(context, view, [...edges[0].points, ...[...edges[1].points].reverse()], true);
    context.fillStyle = paint.road;
    context.fill();
  }
  for (const edge of edges) {
    trace(context, view, edge.points, false);
    stroke(context, paint.edge, 1.5);
  }
  for (const line of site.lines) {
    if (line.kind !== "divider") continue;
    trace(context, view, line.points, false);
    const dash = line.opposed ? [] : [Math.max(3 * view.scale, 4), Math.max(4 * view.scale, 5)];
    stroke(context, paint.mark, line.opposed ? 1.6 : 1.2, dash);
  }
  for (const outline of site.crossings) {
    trace(context, view, outline, true);
    context.globalAlpha = 0.35;
    context.fillStyle = paint.mark;
    context.fill();
    context.globalAlpha = 1;
  }
}

function drawAnchor(context, view, anchor, paint) {
  const [px, py] = view.toScreen(...anchor.at);
  context.beginPath();
  context.moveTo(px - 8, py - 8);
  context.lineTo(px + 8, py + 8);
  context.moveTo(px + 8, py - 8);
  context.lineTo(px - 8, py + 8);
  stroke(context, paint.zone, 3);
}

// -- what moves ------------------------------------------------------------------------------------

export function drawObjects(context, view, objects, trails, stale, paint) {
  for (const one of objects) drawTrail(context, view, trails.get(one.id), roleColour(one.role, paint));
  const taken = [];
  // The VUT comes first in the list, and is drawn last: nothing hides it.
  for (const one of [...objects].reverse()) {
    if (one.x === null || one.y === null || one.yaw === null) continue;
    drawBox(context, view, one, stale.blind || one.stale, paint);
  }
  for (const one of objects) {
    if (one.x === null || one.y === null) continue;
    drawName(context, view, one, stale.blind || one.stale, taken, objects.length > 12, paint);
  }
}

function drawTrail(context, view, trail, colour) {
  if (!trail || trail.length < 2) return;
  const parts = 4;
  for (let part = 0; part < parts; part += 1) {
    const from = Math.floor((part * (trail.length - 1)) / parts);
    const to = Math.floor(((part + 1) * (trail.length - 1)) / parts);
    if (to <= from) continue;
    trace(context, view, trail.slice(from, to + 1).map(([, x, y]) => [x, y]), false);
    context.globalAlpha = 0.2 + 0.2 * part;
    stroke(context, colour, 3);
  }
  context.globalAlpha = 1;
}

function drawBox(context, view, one, silent, paint) {
  const [px, py] = view.toScreen(one.x, one.y);
  const grow = Math.max(1, SHOWN_BOX_PX / ((one.front + one.rear) * view.scale));
  const scale = view.scale * grow;
  const colour = roleColour(one.role, paint);
  context.save();
  context.translate(px, py);
  context.rotate(-one.yaw);
  const [front, rear, half] = [one.front * scale, -one.rear * scale, (one.width * scale) / 2];
  context.beginPath();
  context.rect(rear, -half, front - rear, 2 * half);
  if (silent) {
    context.globalAlpha = 0.8;
    stroke(context, paint.quiet, 2, [4, 3]);
  } else {
    context.fillStyle = colour;
    context.fill();
    const off = one.control === "ABORTING" || one.late;
    stroke(context, off ? paint.abort : paint.text, off ? 4 : 1.4);
    // The nose, so that everybody sees which way it looks.
    const nose = Math.min(half * 1.2, (front - rear) / 3);
    context.beginPath();
    context.moveTo(front, 0);
    context.lineTo(front - nose, -half);
    context.lineTo(front - nose, half);
    context.closePath();
    context.fillStyle = paint.back;
    context.globalAlpha = 0.55;
    context.fill();
  }
  context.restore();
}

function drawName(context, view, one, silent, taken, many, paint) {
  const [px, py] = view.toScreen(one.x, one.y);
  if (px < -50 || py < -50 || px > view.width + 50 || py > view.height + 50) return;
  const more = silent ? "?" : one.control === "ABORTING" ? "ABORTING"
    : Math.abs(one.speed ?? 0) < 0.05 ? "" : one.speed.toFixed(1);
  const text = `${one.id} ${more}`.trim();
  context.font = `${one.role === "VUT" ? 700 : 600} ${many ? 13 : 15}px system-ui, sans-serif`;
  const width = context.measureText(text).width;
  // Names that would lie on each other are put lower.
  const above = (one.width * view.scale) / 2 + Math.abs(Math.sin(one.yaw)) * one.front * view.scale;
  const box = { x: px - 4, y: py - 24 - Math.min(above, 60), w: width + 6, h: 18 };
  const hits = (a) => a.x < box.x + box.w && box.x < a.x + a.w && a.y < box.y + box.h &&
    box.y < a.y + a.h;
  for (let tries = 0; tries < 24 && taken.some(hits); tries += 1) box.y += 9;
  taken.push(box);
  context.lineJoin = "round";
  context.lineWidth = 4;
  context.strokeStyle = paint.back;
  context.strokeText(text, box.x, box.y + 14);
  context.fillStyle = silent ? paint.quiet : one.control === "ABORTING" ? paint.bad
    : roleColour(one.role, paint);
  context.fillText(text, box.x, box.y + 14);
}

function label(context, view, at, text, colour) {
  const [px, py] = view.toScreen(...at);
  context.font = "13px system-ui, sans-serif";
  context.fillStyle = colour;
  context.fillText(text, px + 4, py - 4);
}

// -- where one is ----------------------------------------------------------------------------------

// The whole site, small, with what is seen of it: only where more than that is to be seen.
export function drawOverview(context, view, site, objects, paint) {
  const [left, bottom, right, top] = site.bounds;
  const [seenLeft, seenBottom] = view.toMap(0, view.height);
  const [seenRight, seenTop] = view.toMap(view.width, 0);
  const share = (from, to, low, high) => (Math.min(to, high) - Math.max(from, low)) / (high - low);
  if (share(seenLeft, seenRight, left, right) * share(seenBottom, seenTop, bottom, top) > 0.6) return;
  const scale = Math.min((view.width * 0.34) / (right - left), (view.height * 0.25) / (top - bottom));
  const [wide, high] = [(right - left) * scale, (top - bottom) * scale];
  const [x0, y0] = [view.width - wide - 14, view.height - high - 14];
  const place = (x, y) => [x0 + (x - left) * scale, y0 + high - (y - bottom) * scale];
  context.globalAlpha = 0.88;
  context.fillStyle = paint.panel;
  context.fillRect(x0 - 6, y0 - 6, wide + 12, high + 12);
  context.globalAlpha = 1;
  const small = { toScreen: place };
  trace(context, small, site.fence, true);
  stroke(context, paint.fence, 1.5);
  for (const line of site.lines) {
    if (line.kind !== "edge") continue;
    trace(context, small, line.points, false);
    stroke(context, paint.edge, 1);
  }
  for (const one of [...objects].reverse()) {
    if (one.x === null || one.y === null) continue;
    const [px, py] = place(one.x, one.y);
    context.beginPath();
    context.arc(px, py, 3.5, 0, 2 * Math.PI);
    context.fillStyle = roleColour(one.role, paint);
    context.fill();
  }
  const [fromX, fromY] = place(Math.max(seenLeft, left), Math.min(seenTop, top));
  const [toX, toY] = place(Math.min(seenRight, right), Math.max(seenBottom, bottom));
  context.beginPath();
  context.rect(fromX - 2, fromY - 2, toX - fromX + 4, toY - fromY + 4);
  stroke(context, paint.text, 1.5);
}


export function drawScale(context, view, paint) {
  const wanted = 110 / view.scale;
  const power = 10 ** Math.floor(Math.log10(wanted));
  const length = [5, 2, 1].map((n) => n * power).find((n) => n <= wanted) ?? power;
  const wide = length * view.scale;
  const [x, y] = [14, view.height - 14];
  context.beginPath();
  context.moveTo(x, y - 7);
  context.lineTo(x, y);
  context.lineTo(x + wide, y);
  context.lineTo(x + wide, y - 7);
  stroke(context, paint.text, 2);
  context.font = "600 14px system-ui, sans-serif";
  context.fillStyle = paint.text;
  context.fillText(`${length < 1 ? length.toFixed(1) : length} m`, x + 6, y - 6);
}
