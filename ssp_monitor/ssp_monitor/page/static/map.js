// The map: what stands still, what moves, and the trail of where it was.

import { byId, setText } from "./format.js";
import { colours, drawObjects, drawScale, drawSite } from "./drawing.js";
import { View } from "./view.js";

const TRAIL_MS = 8000;
const MOST_TRAIL = 120;

export class SiteMap {
  constructor(canvas, note) {
    this.canvas = canvas;
    this.note = note;
    this.context = canvas.getContext("2d");
    this.site = { known: false };
    this.objects = [];
    this.trails = new Map();
    this.stale = { blind: true };
    this.follows = false;
    this.fitted = false;
    this.waiting = false;
    this.colours = colours();
    this.view = new View(canvas, () => this.later(), (how) => {
      if (how === "pan") this.follow(false);
    });
    new ResizeObserver(() => this.resize()).observe(canvas);
    matchMedia("(prefers-color-scheme: light)").addEventListener("change", () => {
      this.colours = colours();
      this.later();
    });
    byId("zoom-in").onclick = () => this.view.zoom(1.35);
    byId("zoom-out").onclick = () => this.view.zoom(1 / 1.35);
    byId("fit-site").onclick = () => this.fitSite();
    byId("fit-objects").onclick = () => this.fitObjects();
    byId("follow").onclick = () => this.follow(!this.follows);
    canvas.addEventListener("keydown", (event) => {
      if (event.key === "f") this.fitSite();
      else if (!this.view.key(event.key)) return;
      event.preventDefault();
    });
  }

  setSite(site) {
    const same = JSON.stringify(site) === JSON.stringify(this.site);
    this.site = site;
    this.note.hidden = site.known;
    setText(this.note, site.known ? "" : "No run file: the site isn't drawn.");
    // A page that comes back keeps the view that somebody chose.
    if (!same) this.fitted = false;
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

  follow(on) {
    this.follows = on;
    byId("follow").setAttribute("aria-pressed", String(on));
    if (on && this.view.scale < 6) this.view.scale = 8;
    this.later();
  }

  fitSite() {
    this.follow(false);
    if (this.site.known) this.view.fit(this.site.bounds);
    else this.fitObjects();
  }

  fitObjects() {
    const placed = this.objects.filter((one) => one.x !== null && one.y !== null);
    if (placed.length === 0) return;
    this.follow(false);
    const xs = placed.map((one) => one.x);
    const ys = placed.map((one) => one.y);
    this.view.fit([Math.min(...xs) - 8, Math.min(...ys) - 8, Math.max(...xs) + 8,
      Math.max(...ys) + 8]);
  }

  resize() {
    const ratio = Math.min(devicePixelRatio || 1, 2);
    const box = this.canvas.getBoundingClientRect();
    this.view.width = box.width;
    this.view.height = box.height;
    this.canvas.width = Math.max(1, Math.round(box.width * ratio));
    this.canvas.height = Math.max(1, Math.round(box.height * ratio));
    this.ratio = ratio;
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
    if (!this.fitted && (this.site.known || this.objects.length)) {
      this.fitted = true;
      this.fitSite();
    }
    const vut = this.objects.find((one) => one.role === "VUT");
    if (this.follows && vut && vut.x !== null) {
      this.view.x = vut.x;
      this.view.y = vut.y;
    }
    const context = this.context;
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    context.clearRect(0, 0, this.view.width, this.view.height);
    if (this.site.known) drawSite(context, this.view, this.site, this.colours);
    drawObjects(context, this.view, this.objects, this.trails, this.stale, this.colours);
    drawScale(context, this.view, this.colours);
    this.drawMs = performance.now() - began;
    this.canvas.dataset.drawMs = this.drawMs.toFixed(2);
    this.canvas.dataset.objects = String(this.objects.length);
  }
}
