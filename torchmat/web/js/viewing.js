// One viewer: its material, scene and state, and what may be done with them.

import { Acts } from "./acts.js";
import { Camera } from "./camera.js";
import { attachControls } from "./controls.js";
import { openContext } from "./gl.js";
import { Material } from "./material.js";
import { SHAPES, makeMesh, storedMesh } from "./meshes.js";
import { Pace } from "./pace.js";
import { addPanel } from "./panel.js";
import { NoShader, showPictures } from "./pictures.js";
import { Scene } from "./scene.js";
import { advance, startState } from "./state.js";
import { shownColour } from "./colours.js";

const MOST_PIXELS_PER_POINT = 2;
const INTRO = 6000; // milliseconds that the light goes round before anything was touched

/** One viewer; `mount` makes it. */
export class Viewer extends Acts {
  constructor(root, data, options) {
    super();
    Object.assign(this, { root, description: data.description, buffers: data.buffers, extra: data.extra ?? {}, live: options.live ?? false });
    this.embedded = options.embedded ?? false;
    this.listeners = new Map();
    this.frames = 0;
    this.cost = 0;
    this.wanted = 0;
    this.sweptAt = 0;
    this.hidden = false;
    this.start = options.mesh ?? this.extra.shape ?? (this.extra.mesh ? this.extra.mesh.name : "teapot");
    this.state = startState(this.start);
    this.scene = null;
    this.material = null;
    this.context = null;
  }

  /** @param {HTMLCanvasElement} canvas */
  begin(canvas) {
    this.canvas = canvas;
    this.open(canvas);
    this.stopControls = attachControls(canvas, this);
    // Asked for once: to ask in every frame would lay the page out in every frame.
    this.box = canvas.parentElement.getBoundingClientRect();
    this.resized = new ResizeObserver(([entry]) => {
      this.box = entry.contentRect;
      this.redraw();
    });
    this.resized.observe(canvas.parentElement);
    this.watched = new IntersectionObserver(([entry]) => {
      this.hidden = !entry.isIntersecting;
      if (!this.hidden) this.redraw();
    });
    this.watched.observe(canvas);
    this.scheme = matchMedia("(prefers-color-scheme: dark)");
    this.recoloured = () => {
      this.behind = null;
      this.redraw();
    };
    this.scheme.addEventListener("change", this.recoloured);
  }

  /** Get ready to draw into a canvas. */
  open(canvas) {
    if (!this.description.glsl) throw new NoShader();
    // Edges are smoothed in a frame buffer of the scene's own.
    this.context = openContext(canvas, { alpha: false, antialias: false, depth: false, powerPreference: "low-power" });
    this.build();
    this.pace = new Pace(this.context.gl, () => this.redraw(false), Boolean(this.live));
    this.context.onRestore(() => {
      this.pace.forget();
      this.redraw();
    });
  }

  build() {
    this.material = new Material(this.context, this.description, this.buffers);
    this.scene = new Scene(this.context, this.material);
    this.scene.setMesh(this.meshOf(this.state.mesh));
  }

  /** @returns {string[]} names of the objects that can be shown */
  get meshes() {
    return [...SHAPES, ...(this.extra.mesh ? [this.extra.mesh.name] : [])];
  }

  meshOf(name) {
    if (SHAPES.includes(name)) return makeMesh(name);
    this.ownMesh ??= storedMesh(this.extra.mesh, this.buffers);
    return this.ownMesh;
  }

  /** Listen: "change" (of the state), "maps" (of the material), "frame". @returns {() => void} takes the listener away */
  on(event, listener) {
    if (!this.listeners.has(event)) this.listeners.set(event, new Set());
    this.listeners.get(event).add(listener);
    return () => this.listeners.get(event).delete(listener);
  }

  emit(event, detail) {
    this.listeners.get(event)?.forEach((listener) => listener(detail));
  }

  /** Put a panel beside the picture. @returns {HTMLDetailsElement} */
  addPanel(title, content, options = {}) {
    return addPanel(this, title, content, options);
  }

  /** Change the state by a function of it; everything that shows the state follows. */
  change(act) {
    act(this.state);
    this.emit("change", this.state);
    this.name();
    this.redraw();
  }

  /** The picture's name, for those who do not see it. */
  name() {
    if (this.named === this.state.mesh) return;
    this.named = this.state.mesh;
    this.canvas?.setAttribute("aria-label", `The material on: ${this.named}. Arrow keys turn it, with shift they move the light.`);
  }

  /** Draw at the next frame. */
  redraw(stir = true) {
    if (!this.scene) return;
    if (stir) this.pace?.stir();
    if (!this.wanted) this.wanted = requestAnimationFrame((now) => this.frame(now));
  }

  frame(now) {
    this.wanted = 0;
    if (this.gone || this.hidden || this.context.gl.isContextLost()) return;
    if (this.pace.busy()) {
      this.redraw(false);
      return;
    }
    const begun = performance.now();
    const sweeping = this.sweep(now);
    try {
      this.draw();
    } catch (error) {
      this.gone = true;
      this.fail(error);
      return;
    }
    this.cost = performance.now() - begun;
    this.frames += 1;
    this.emit("frame", this.cost);
    if (sweeping) this.redraw(false);
  }

  /** Bring what sweeps forward. @returns {boolean} whether anything does */
  sweep(now) {
    const sweeping = this.state.sweeps.length > 0;
    if (sweeping) {
      advance(this.state, (now - (this.sweptAt || now)) / 1000);
      this.emit("change", this.state);
      this.pace.stir();
    }
    this.sweptAt = sweeping ? now : 0;
    return sweeping;
  }

  /** What cannot be drawn is said, with pictures in its place. */
  fail(error) {
    showPictures(this.stage, error, this.stills);
    this.emit("failed", error);
  }

  draw() {
    const { canvas } = this;
    const dense = Math.min(devicePixelRatio || 1, MOST_PIXELS_PER_POINT);
    const share = this.pace.share();
    const [columns, rows] = [this.box.width, this.box.height].map((side) => Math.max(1, Math.round(side * dense * share)));
    if (canvas.width !== columns || canvas.height !== rows) Object.assign(canvas, { width: columns, height: rows });
    this.scene.draw(this.picture(), columns, rows);
    this.pace.sent(share);
  }

  /** @returns {object} what Scene.draw takes */
  picture() {
    const { state } = this;
    if (this.behind?.chosen !== state.background) this.behind = { chosen: state.background, colour: shownColour(state.background, this.canvas) };
    return {
      camera: new Camera(state.view), lights: state.lights, environment: state.environment, repeat: state.repeat,
      exposure: state.exposure, background: this.behind.colour,
      soften: Boolean(this.description.bright_at_horizon),
    };
  }

  setMesh(name) {
    this.scene?.setMesh(this.meshOf(name));
    this.change((state) => {
      state.mesh = name;
    });
  }

  reset() {
    this.scene?.setMesh(this.meshOf(this.start));
    this.change((state) => Object.assign(state, startState(this.start)));
  }

  /** Somebody takes over: the light's first round ends. */
  touched() {
    if (!this.introduced) return;
    clearTimeout(this.introduced);
    this.introduced = 0;
    this.change((state) => {
      state.sweeps = [];
    });
  }

  /** Let the light go round once, so that the material is seen to move; not for those who asked for stillness. */
  introduce() {
    if (matchMedia("(prefers-reduced-motion: reduce)").matches) return;
    this.change((state) => {
      state.sweeps = ["light.phi"];
    });
    this.introduced = setTimeout(() => this.touched(), INTRO);
  }

  /** Say the angles to those who do not see them. */
  say() {
    const { view, lights, active } = this.state;
    const words = ({ theta, phi }) => `${Math.round(theta)}, ${Math.round(phi)} degrees`;
    this.status.textContent = `View ${words(view)}. Light ${active + 1}: ${words(lights[active])}. ${this.state.mesh}.`;
  }

  /** Put another version of one map in its place. */
  updateMap(name, entry, buffer) {
    this.buffers[name] = buffer;
    this.description.maps = this.description.maps.map((one) => (one.name === name ? entry : one));
    this.material?.update(name, entry, buffer);
    this.emit("maps", name);
    this.redraw();
  }

  /** Show another material. */
  setMaterial(description, buffers) {
    Object.assign(this, { description, buffers: { ...this.buffers, ...buffers } });
    if (this.context) {
      const before = this.material;
      this.material = new Material(this.context, this.description, this.buffers);
      this.scene.setMaterial(this.material);
      before.dispose();
    }
    this.emit("maps", null);
    this.redraw();
  }

  /** Take everything away again. */
  remove() {
    this.gone = true;
    cancelAnimationFrame(this.wanted);
    this.pace?.stop();
    this.stopControls?.();
    this.resized?.disconnect();
    this.watched?.disconnect();
    this.scheme?.removeEventListener("change", this.recoloured);
    this.scene?.dispose();
    this.material?.dispose();
    this.root.replaceChildren();
  }
}
