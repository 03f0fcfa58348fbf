// The object, how often the texture repeats on it, and how bright the picture is.

import { BACKGROUNDS } from "./colours.js";
import { choice, element, labelled, slider } from "./dom.js";

/** @param {import("./viewing.js").Viewer} viewer @returns {HTMLElement} */
export function objectPanel(viewer) {
  const change = (name) => (value) => viewer.change((state) => {
    state[name] = value;
  });
  const mesh = choice(viewer.meshes.map((name) => [name, name[0].toUpperCase() + name.slice(1)]), viewer.state.mesh, (name) => viewer.setMesh(name));
  const repeat = slider({ label: "Repeat", low: 0.25, high: 8, step: 0.25, value: viewer.state.repeat, changed: change("repeat") });
  const exposure = slider({ label: "Exposure", unit: "stops", low: -6, high: 6, step: 0.25, value: 0, changed: change("exposure") });
  const background = choice(BACKGROUNDS, "page", change("background"));
  viewer.on("change", (state) => {
    mesh.value = state.mesh;
    repeat.set(state.repeat);
    exposure.set(state.exposure);
    background.value = state.background;
  });
  return element("div", {}, labelled("Shape", mesh), repeat.row, exposure.row, labelled("Background", background));
}
