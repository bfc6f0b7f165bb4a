// The front camera's newest picture, with its age.

import { byId, setText } from "./format.js";

const OLD_S = 1.5;

export class Camera {
  constructor() {
    this.canvas = byId("camera");
    this.context = this.canvas.getContext("2d");
    this.busy = false;
    this.expected = true;
    this.drawn = null;
  }

  // A run without a camera needs no place for one.
  expect(has) {
    this.expected = has !== false;
    byId("camera-panel").hidden = !this.expected;
  }

  async take(blob) {
    // One that comes while another is decoded is left out: the next one is newer.
    if (this.busy) return;
    this.busy = true;
    try {
      const picture = await createImageBitmap(blob);
      if (this.canvas.width !== picture.width || this.canvas.height !== picture.height) {
        this.canvas.width = picture.width;
        this.canvas.height = picture.height;
      }
      this.context.drawImage(picture, 0, 0);
      picture.close();
      this.broken = false;
      this.drawn = performance.now();
    } catch {
      this.broken = true;
    } finally {
      this.busy = false;
    }
  }

  // How old the picture on the screen is, in s: as the server heard it, or as it was drawn here.
  age(snapshot) {
    if (snapshot === null || this.drawn === null || snapshot.ages.camera === null) return null;
    return Math.max(snapshot.ages.camera, (performance.now() - this.drawn) / 1000);
  }

  show(snapshot, stale) {
    const age = this.age(snapshot);
    const fault = snapshot?.camera_fault ?? "";
    const ended = Boolean(snapshot?.end);
    const old = ended || stale.blind || age === null || age > OLD_S;
    if ((age !== null || fault) && !this.expected) this.expect(true);
    const known = age !== null && !stale.blind && !ended;
    setText(byId("camera-age"), known ? `${(age * 1000).toFixed(0)} ms old` : "");
    const note = byId("camera-note");
    note.hidden = !(old || this.broken || fault);
    let text = "the picture can't be decoded";
    if (fault) text = `camera: ${fault}`;
    else if (age === null) text = "no picture has come";
    else if (ended || stale.blind) text = "last picture received";
    else if (old) text = `no picture for ${age.toFixed(1)} s`;
    setText(note, text);
  }
}
