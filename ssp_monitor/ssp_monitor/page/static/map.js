// The map: what stands still, what moves, and the trail of where it was.

import { byId, setText } from "./format.js";
import { colours, drawObjects, drawOverview, drawScale, drawSite } from "./drawing.js";
import { View } from "./view.js";

const TRAIL_MS = 8000;
const MOST_TRAIL = 120;
// What is seen around the objects, and how fast the view goes where it should be.
const AROUND_M = 14;
const LEAST_SEEN_M = 70;
const EASE = 0.18;
const MODES = ["objects", "vut", "site"];

export class SiteMap {
  constructor(canvas, note) {
    this.canvas = canvas;
    this.note = note;
    this.context = canvas.getContext("2d");
    this.site = { known: false };
    this.objects = [];
    this.trails = new Map();
    this.stale = { blind: true };
    // objects: all of them in view; vut: follows it; site: all of it; empty: as people left it.
    this.mode = "objects";
    this.jump = true;
    this.waiting = false;
    this.colours = colours();
    this.view = new View(canvas, () => this.later(), (how) => {
      // Whoever zooms while the map follows the VUT wants to see it larger, not elsewhere.
      if (how === "pan" || this.mode !== "vut") this.choose("");
    });
    new ResizeObserver(() => this.resize()).observe(canvas);
    matchMedia("(prefers-color-scheme: light)").addEventListener("change", () => {
      this.colours = colours();
      this.later();
    });
    byId("zoom-in").onclick = () => this.view.byHand(1.35);
    byId("zoom-out").onclick = () => this.view.byHand(1 / 1.35);
    for (const mode of MODES) byId(`mode-${mode}`).onclick = () => this.choose(mode);
    canvas.addEventListener("keydown", (event) => {
      if (event.key === "f") this.choose("objects");
      else if (event.key === "s") this.choose("site");
      else if (!this.view.key(event.key)) return;
      event.preventDefault();
    });
  }

  setSite(site) {
    this.site = site;
    this.note.hidden = site.known;
    setText(this.note, site.known ? "" : "No run file: the site isn't drawn.");
    this.later();
  }

  show(objects, stale) {
    const now = performance.now();
    this.objects = objects;
    this.stale = stale;
    const present = new Set();
    for (const one of objects) {
      present.add(one.id);
      if (one.x === null || one.y === null || one.stale || stale.blind) continue;
      const trail = this.trails.get(one.id) ?? [];
      const last = trail[trail.length - 1];
      // A new run begins elsewhere: no line is drawn to there.
      if (last && Math.hypot(one.x - last[1], one.y - last[2]) > 25) trail.length = 0;
      trail.push([now, one.x, one.y]);
      while (trail.length > MOST_TRAIL || now - trail[0][0] > TRAIL_MS) trail.shift();
      this.trails.set(one.id, trail);
    }
    for (const id of this.trails.keys()) if (!present.has(id)) this.trails.delete(id);
    this.later();
  }

  // -- view ------------------------------------------------------------------------------------

  choose(mode) {
    this.mode = mode;
    this.jump = true;
    for (const one of MODES) byId(`mode-${one}`).setAttribute("aria-pressed", String(one === mode));
    if (mode === "vut") this.view.scale = Math.max(this.view.scale, 9);
    this.later();
  }

  // Where the view should be, in the present mode; null: where it is.
  wanted() {
    const placed = this.objects.filter((one) => one.x !== null && one.y !== null);
    if (this.mode === "vut") {
      const vut = placed.find((one) => one.role === "VUT");
      return vut ? { x: vut.x, y: vut.y, scale: this.view.scale } : null;
    }
    if (this.mode === "") return null;
    const led = placed.filter((one) => one.role !== "TRAFFIC");
    if (this.mode === "objects" && led.length) {
      const bounds = around(led.map((one) => [one.x, one.y]), AROUND_M);
      return this.view.fitting(bounds, LEAST_SEEN_M);
    }
    return this.site.known ? this.view.fitting(this.site.bounds, 1) : null;
  }

  steer() {
    const wanted = this.wanted();
    if (wanted === null) return;
    const share = this.jump || this.mode === "vut" ? 1 : EASE;
    for (const name of ["x", "y", "scale"]) {
      this.view[name] += (wanted[name] - this.view[name]) * share;
    }
    this.jump = false;
  }

  resize() {
    const ratio = Math.min(devicePixelRatio || 1, 2);
    const box = this.canvas.getBoundingClientRect();
    this.view.width = box.width;
    this.view.height = box.height;
    this.canvas.width = Math.max(1, Math.round(box.width * ratio));
    this.canvas.height = Math.max(1, Math.round(box.height * ratio));
    this.ratio = ratio;
    this.jump = true;
    this.later();
  }

  // -- drawing ---------------------------------------------------------------------------------

  later() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.draw();
    });
  }

  draw() {
    const began = performance.now();
    if (this.ratio === undefined) return;
    this.steer();
    const context = this.context;
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    context.clearRect(0, 0, this.view.width, this.view.height);
    if (this.site.known) drawSite(context, this.view, this.site, this.colours);
    drawObjects(context, this.view, this.objects, this.trails, this.stale, this.colours);
    drawScale(context, this.view, this.colours);
    if (this.site.known) drawOverview(context, this.view, this.site, this.objects, this.colours);
    this.drawMs = performance.now() - began;
    this.canvas.dataset.drawMs = this.drawMs.toFixed(2);
    this.canvas.dataset.objects = String(this.objects.length);
  }
}

function around(points, margin) {
  const xs = points.map(([x]) => x);
  const ys = points.map(([, y]) => y);
  return [Math.min(...xs) - margin, Math.min(...ys) - margin, Math.max(...xs) + margin,
    Math.max(...ys) + margin];
}
