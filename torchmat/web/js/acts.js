// What may be done with a viewer by hand: turn, light, come nearer, sweep.

import { Camera, normalised, orbited } from "./camera.js";
import { MOST_LIGHTS, makeLight } from "./lights.js";

/** The acts of a Viewer, on its state alone. */
export class Acts {
  /** Turn the camera round the object, by degrees to the right and up. */
  turn(right, up) {
    this.change((state) => Object.assign(state.view, normalised(orbited(state.view, right, up))));
  }

  /** Move the chosen light; `away` is a factor on the distance of a point light. */
  moveLight(right, up, away = 1) {
    this.change((state) => {
      const light = state.lights[state.active];
      Object.assign(light, normalised(orbited(light, right, up)));
      light.distance = Math.min(10, Math.max(1.1, light.distance * away));
    });
  }

  zoom(factor) {
    this.change((state) => {
      const camera = new Camera(state.view);
      camera.zoomBy(factor);
      state.view.zoom = camera.zoom;
    });
  }

  expose(stops) {
    this.change((state) => {
      state.exposure = Math.min(6, Math.max(-6, state.exposure + stops));
    });
  }

  nextMesh() {
    this.setMesh(this.meshes[(this.meshes.indexOf(this.state.mesh) + 1) % this.meshes.length]);
  }

  nextLight() {
    this.change((state) => {
      state.active = (state.active + 1) % state.lights.length;
    });
  }

  addLight() {
    if (this.state.lights.length === MOST_LIGHTS) return;
    this.change((state) => {
      state.lights.push(makeLight({ theta: 50, phi: (state.lights.at(-1).phi + 90) % 360, strength: 0.5 }));
      state.active = state.lights.length - 1;
    });
  }

  removeLight() {
    this.change((state) => {
      if (state.lights.length > 1) state.lights.splice(state.active, 1);
      state.active = Math.min(state.active, state.lights.length - 1);
    });
  }

  toggleSweep(name) {
    this.change((state) => {
      state.sweeps = state.sweeps.includes(name) ? state.sweeps.filter((one) => one !== name) : [...state.sweeps, name];
    });
  }

  toggleSweeps() {
    this.change((state) => {
      this.rested ??= ["light.phi"];
      [state.sweeps, this.rested] = state.sweeps.length ? [[], state.sweeps] : [this.rested, state.sweeps];
    });
  }
}
