// Lights of a scene as torchmat/rendering/lights.py has them, and presets that stand for an environment.

import { directionOf } from "./camera.js";
import { ENVIRONMENTS } from "./environments.js";

/** How many lights of one's own there may be, and how many a shader sums with those of an environment. */
export const MOST_LIGHTS = 4;
export const MOST_IN_ALL = 12;
/** At so many radii of the object a point light is as bright as a distant one. */
export const USUAL_DISTANCE = 3;

/**
 * @typedef {object} Light
 * @property {"directional"|"point"} kind
 * @property {number} theta degrees from +z
 * @property {number} phi degrees about z
 * @property {number} distance of a point light from the object's centre, in its radii
 * @property {number} strength a white diffuse surface that faces a light of 1 reads 1
 * @property {number[]} colour linear RGB
 */

const START = { kind: "directional", theta: 39.82, phi: 128.66, distance: USUAL_DISTANCE, strength: 1, colour: [1, 1, 1] };

/** @param {Partial<Light>} given @returns {Light} */
export function makeLight(given = {}) {
  return { ...START, ...given };
}

/** Names of the environments, and what they are called. */
export const environmentNames = () => Object.entries(ENVIRONMENTS).map(([name, one]) => [name, one.title]);

/**
 * Return the lights as a shader takes them.
 * @param {Light[]} lights
 * @param {string} environment one of the presets, or "" for none
 * @param {{centre: number[], radius: number}} object
 * @returns {{place: Float32Array, colour: Float32Array, count: number}} x, y, z toward each (w 0) or of it (w 1); RGB
 */
export function forShader(lights, environment, object) {
  const place = new Float32Array(4 * MOST_IN_ALL);
  const colour = new Float32Array(3 * MOST_IN_ALL);
  let count = 0;
  const add = (where, shine) => {
    place.set(where, 4 * count);
    colour.set(shine, 3 * count);
    count += 1;
  };
  for (const light of lights) {
    if (!(light.strength > 0)) continue;
    const direction = directionOf(light);
    if (light.kind === "point") {
      const usual = (USUAL_DISTANCE * object.radius) ** 2;
      const where = direction.map((one, k) => object.centre[k] + one * light.distance * object.radius);
      add([...where, 1], light.colour.map((one) => one * light.strength * usual));
    } else {
      add([...direction, 0], light.colour.map((one) => one * light.strength));
    }
  }
  for (const [direction, shine] of ENVIRONMENTS[environment]?.lights ?? []) {
    if (count < MOST_IN_ALL) add([...direction, 0], shine);
  }
  return { place, colour, count };
}
