// Nine views of the flat material over the hemisphere, each the value that `shade` has, and their half vectors in the specular map.

import { directionOf, unit } from "./camera.js";
import { element, choice, labelled, slider } from "./dom.js";
import { evaluate } from "./evaluate.js";
import { encoded } from "./scene.js";
import { thumbnail } from "./thumbnails.js";

/** Azimuths of light and view, row by row: as the views lie, round the middle one, whose light and view face each other. */
export const AZIMUTHS = [[135, 135], [90, 90], [45, 45], [180, 180], [0, 180], [0, 0], [225, 225], [270, 270], [315, 315]];
const MAP = 240;
const WAIT = 300; // milliseconds after a change: the picture itself comes first
const SWEEP = 20; // degrees a second
const SPAN = 90;

/** @returns {{light: number[], view: number[]}[]} the nine pairs of two polar angles in degrees */
export function ninePairs(light, view) {
  return AZIMUTHS.map(([one, other]) => ({ light: directionOf({ theta: light, phi: one }), view: directionOf({ theta: view, phi: other }) }));
}

/** @returns {number[]} place in a parabolic map, u to the right and v up, 0 to 1, of the half vector of a pair */
export function markOf({ light, view }) {
  const half = unit(light.map((one, k) => one + view[k]));
  return [0, 1].map((k) => 0.5 + half[k] / (1 + half[2]) / 2);
}

/** @returns {number[] | null} the half vector of a place in a parabolic map, null outside its disc */
export function halfOf([u, v]) {
  const [x, y] = [2 * u - 1, 2 * v - 1];
  const squared = x * x + y * y;
  return squared > 1 ? null : [2 * x / (1 + squared), 2 * y / (1 + squared), (1 - squared) / (1 + squared)];
}

/** One specular map of a description, as an entry of its own. */
function layerOf(viewer, place) {
  const entry = viewer.description.maps.find((one) => one.name === "specular");
  if (!entry) return null;
  const size = viewer.buffers.specular.byteLength / entry.layers;
  const own = (numbers) => numbers.slice(place * entry.channels, (place + 1) * entry.channels);
  const alone = { ...entry, layers: 1, low: own(entry.low), high: own(entry.high) };
  return thumbnail(alone, viewer.buffers.specular.slice(place * size, (place + 1) * size), MAP);
}

class NineViews {
  constructor(viewer) {
    Object.assign(this, { viewer, light: 30, view: 30, chosen: 4, layer: 0, timer: 0 });
    Object.assign(this, { own: new Map(), waiting: [], swept: { light: 0, view: 0 } });
    this.canvases = AZIMUTHS.map(([one, other], place) => element("canvas", {
      class: "tms-picture", role: "img", tabindex: 0, "aria-label": `Light from ${one}, view from ${other} degrees`,
      onclick: () => this.choose(place), onkeydown: (event) => (event.key === "Enter" ? this.choose(place) : null),
    }));
    this.frame = element("div", { class: "tms-select tms-marks", onclick: (event) => this.pressed(event) });
    const sliders = [["light", "Light θ"], ["view", "View θ"]].map(([name, label]) => this.angle(name, label));
    const reset = element("button", { type: "button", onclick: () => {
      this.own.clear();
      this.changed();
    } }, "Start again");
    this.layers = element("div", {});
    this.element = element("div", {}, element("div", { class: "tms-three" }, ...this.canvases), ...sliders, this.layers, this.frame,
      element("p", { class: "tms-caption" }, "Red: the half vector of each view. Press a view, then a place in the map, and the view shows it."),
      element("div", { class: "tmv-buttons" }, reset));
    viewer.on("maps", () => this.changed());
    this.choose(4);
  }

  angle(name, label) {
    const look = { type: "button", class: "tmv-sweep", "aria-label": `Sweep the ${name}`, "aria-pressed": "false" };
    const button = element("button", { ...look, onclick: () => {
      this.swept[name] = this.swept[name] ? 0 : 1;
      button.setAttribute("aria-pressed", String(Boolean(this.swept[name])));
      this.at = performance.now();
      this.sweep();
    } }, "▶");
    const made = slider({ label, low: 0, high: SPAN, step: 1, value: this[name], extra: button, changed: (value) => this.turn(name, value) });
    this[`${name}Set`] = made.set;
    return made.row;
  }

  turn(name, value) {
    this[name] = value;
    this[`${name}Set`](value);
    this.changed(0);
  }

  /** To and fro: at the ends the light would go under. */
  sweep() {
    const names = Object.keys(this.swept).filter((name) => this.swept[name]);
    if (!names.length || this.viewer.gone || !this.open) return;
    const now = performance.now();
    for (const name of names) {
      let next = this[name] + this.swept[name] * SWEEP * Math.min(0.25, (now - this.at) / 1000);
      if (next > SPAN || next < 0) this.swept[name] *= -1;
      next = Math.min(SPAN, Math.max(0, next));
      this.turn(name, next);
    }
    this.at = now;
    cancelAnimationFrame(this.next);
    this.next = requestAnimationFrame(() => this.sweep());
  }

  /** They are seen again: what was put off is drawn, and what swept goes on. */
  opened() {
    this.at = performance.now();
    this.changed(0);
    this.sweep();
  }

  choose(place) {
    this.chosen = place;
    this.canvases.forEach((canvas, k) => canvas.classList.toggle("tms-chosen", k === place));
  }

  pressed(event) {
    const box = this.frame.getBoundingClientRect();
    const half = halfOf([(event.clientX - box.left) / box.width, 1 - (event.clientY - box.top) / box.height]);
    if (!half || half[2] <= 0) return;
    this.own.set(this.chosen, { light: half, view: half });
    this.changed(0);
  }

  /** @returns {{light: number[], view: number[]}[]} what each view shows */
  get pairs() {
    return ninePairs(this.light, this.view).map((pair, place) => this.own.get(place) ?? pair);
  }

  get open() {
    return this.element.checkVisibility(); // folded away it has a place in the page still
  }

  changed(wait = WAIT) {
    this.waiting = AZIMUTHS.map((_, place) => place);
    this.marked = false;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.step(), wait);
  }

  /** Draw one of the views that wait, and leave as long as that took to others. */
  step() {
    if (!this.open || !this.viewer.context || this.viewer.gone) return;
    if (!this.marked) this.mark();
    const place = this.waiting.shift();
    if (place === undefined) return;
    const begun = performance.now();
    this.draw(place);
    this.timer = setTimeout(() => this.step(), Math.min(500, performance.now() - begun));
  }

  draw(place) {
    const { light, view } = this.pairs[place];
    const [height, width] = this.viewer.material.description.size;
    const values = evaluate(this.viewer.context, this.viewer.material, light, view);
    const canvas = this.canvases[place];
    Object.assign(canvas, { width, height });
    const pixels = new ImageData(width, height);
    for (let at = 0; at < values.length; at += 1) {
      pixels.data[at] = at % 4 === 3 ? 255 : Math.round(255 * encoded(Math.min(1, Math.max(0, values[at]))));
    }
    canvas.getContext("2d").putImageData(pixels, 0, 0);
  }

  mark() {
    this.marked = true;
    const entry = this.viewer.description.maps.find((one) => one.name === "specular");
    const count = entry?.layers ?? 0;
    this.layer = Math.min(this.layer, Math.max(0, count - 1));
    if (this.layers.childElementCount !== Number(count > 1)) {
      const names = Array.from({ length: count }, (_, k) => [String(k), `Specular map ${k + 1}`]);
      const chosen = choice(names, String(this.layer), (value) => {
        this.layer = Number(value);
        this.mark();
      });
      this.layers.replaceChildren(...(count > 1 ? [labelled("Map", chosen)] : []));
    }
    const picture = layerOf(this.viewer, this.layer);
    picture?.classList.add("tms-picture");
    const marks = this.pairs.map((pair) => markOf(pair)).map(([u, v]) => {
      const mark = element("i", { class: "tms-mark" });
      Object.assign(mark.style, { left: `${100 * u}%`, top: `${100 * (1 - v)}%` });
      return mark;
    });
    this.frame.replaceChildren(...(picture ? [picture] : []), ...marks);
  }
}

/** @param {import("./viewing.js").Viewer} viewer @returns {NineViews} its `element` is what a panel holds */
export function nineViews(viewer) {
  return new NineViews(viewer);
}
