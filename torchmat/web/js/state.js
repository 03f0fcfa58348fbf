// What a viewer shows: angles, lights, object. A plain object, so that it can be kept and brought back.

import { anglesOf } from "./camera.js";
import { makeLight } from "./lights.js";

const THREE_QUARTER = [0.7, 0.5, 1.0]; // a front view shows one side of an object, and lids and rims as lines
const LENGTH = Math.hypot(...THREE_QUARTER);
const SWEEP = 30; // degrees a second

/** The angles that sweep, and their ends. */
export const SWEPT = { "view.theta": [-180, 180], "view.phi": [0, 360], "light.theta": [-180, 180], "light.phi": [0, 360] };

/**
 * @param {string} mesh the object shown first
 * @returns {object} the state at the start
 */
export function startState(mesh) {
  const view = mesh === "quad" ? { theta: 0, phi: 0 } : anglesOf(THREE_QUARTER.map((one) => one / LENGTH), { theta: 0, phi: 0 });
  return {
    mesh, view: { ...view, zoom: 1, perspective: false }, lights: [makeLight()], active: 0, environment: "",
    repeat: mesh === "sphere" ? 2 : 1, exposure: 0, background: "page", sweeps: [],
  };
}

/**
 * Bring the swept angles forward.
 * @param {object} state
 * @param {number} seconds since the last time
 */
export function advance(state, seconds) {
  for (const name of state.sweeps) {
    const [whose, angle] = name.split(".");
    const one = whose === "view" ? state.view : state.lights[state.active];
    const [low, high] = SWEPT[name];
    one[angle] += SWEEP * Math.min(seconds, 0.25);
    if (one[angle] > high) one[angle] -= high - low;
  }
}
