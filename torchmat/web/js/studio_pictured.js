// A material that no shader draws: the studio makes its pictures, small ones while something moves, and the full one at rest.

import { directionOf } from "./camera.js";
import { forShader } from "./lights.js";
import { encoded } from "./scene.js";
import { Viewer } from "./viewing.js";

const MOVING = 150; // milliseconds that a picture may take while something moves
const RESTING = 1500; // and at rest
const REST = 220; // milliseconds without a change until the full picture is asked for
const LEAST = 0.2;
const FINER = 1.25;
const MOST = 640; // pixels along the longer side
const START = 400; // milliseconds of a full picture: a guess until one was timed

/** How finely to ask for pictures, by how long they take. */
class Pace {
  constructor(rested) {
    Object.assign(this, { rested, moving: false, whole: START, coarse: true, pictures: 0 });
  }

  stir() {
    this.moving = true;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => {
      this.moving = false;
      if (this.coarse) this.rested();
    }, REST);
  }

  /** @returns {number} the factor on the pixels' number along a side of the next picture; after one that moved, a finer one is due at rest */
  share() {
    this.coarse = this.moving;
    return Math.max(LEAST, Math.min(1, Math.sqrt((this.moving ? MOVING : RESTING) / this.whole)));
  }

  /** The first picture waits for all that makes pictures to be loaded, which says nothing of those to come; the second ends the guess. */
  took(share, milliseconds) {
    const found = Math.max(1, milliseconds / share ** 2);
    if (this.pictures > 0) this.whole = this.pictures > 1 ? (this.whole + found) / 2 : found;
    this.pictures += 1;
    // One that could have been much finer is made anew: each is finer than the last, so that it ends.
    this.coarse ||= Math.min(1, Math.sqrt(RESTING / this.whole)) > FINER * share;
  }

  stop() {
    clearTimeout(this.timer);
  }
}

/** A Viewer whose pictures the studio makes; `options.pictures` asks for one and returns a PNG in base64. */
export class PicturedViewer extends Viewer {
  constructor(root, data, options) {
    super(root, data, options);
    this.ask = options.pictures;
  }

  open(canvas) {
    this.paper = canvas.getContext("2d");
    this.pace = new Pace(() => this.redraw(false));
    this.scene = { setMesh: (mesh) => Object.assign(this, { mesh }), dispose: () => {} };
    this.scene.setMesh(this.meshOf(this.state.mesh));
  }

  redraw(stir = true) {
    this.changed ||= stir;
    super.redraw(stir);
  }

  frame(now) {
    this.wanted = 0;
    if (this.gone || this.hidden || this.asking) return; // what changes meanwhile is asked for after that
    const sweeping = this.sweep(now);
    this.changed = false;
    const share = this.pace.share();
    const begun = performance.now();
    this.asking = this.show(share).then(() => this.pace.took(share, performance.now() - begun), (error) => {
      this.pace.coarse = false; // the same again would fail as well
      this.emit("failed", error);
    }).finally(() => {
      this.asking = null;
      if (sweeping || this.changed || (!this.pace.moving && this.pace.coarse)) this.redraw(false);
    });
  }

  /** Have a picture made, of so much of the pixels along a side, and show it. */
  async show(share) {
    const { state, mesh } = this;
    const longest = share * Math.min(MOST, Math.max(this.box.width, this.box.height)) / Math.max(this.box.width, this.box.height, 1);
    const [columns, rows] = [this.box.width, this.box.height].map((side) => Math.max(1, Math.round(side * longest)));
    const { place, colour, count } = forShader(state.lights, state.environment, mesh);
    const lights = Array.from({ length: count }, (_, k) => [[...place.slice(4 * k, 4 * k + 4)], [...colour.slice(3 * k, 3 * k + 3)]]);
    const { background } = this.picture();
    const png = await this.ask({
      mesh: state.mesh, view: directionOf(state.view), zoom: state.view.zoom, perspective: state.view.perspective, lights,
      repeat: state.repeat, exposure: state.exposure, size: [rows, columns],
    });
    const bytes = Uint8Array.from(atob(png), (letter) => letter.charCodeAt(0));
    const picture = await createImageBitmap(new Blob([bytes], { type: "image/png" }));
    if (this.gone) return;
    Object.assign(this.canvas, { width: columns, height: rows });
    this.paper.fillStyle = `rgb(${background.map((one) => 255 * encoded(one)).join(" ")})`;
    this.paper.fillRect(0, 0, columns, rows);
    this.paper.drawImage(picture, 0, 0);
    this.frames += 1;
    this.emit("frame", 0);
  }
}
