// The controls that make maps: height, normals, mask and Fresnel from the brightness of the diffuse map.

import { element, slider } from "./dom.js";

const SINGLE = [
  { name: "height_scale", key: "scale", label: "Height scale", low: 0, high: 0.3, step: 0.001, usual: 0.05, decimals: 3 },
  { name: "normal_strength", key: "strength", label: "Normals, times", low: 1, high: 8, step: 0.1, usual: 1 },
  { name: "darken", key: "share", label: "Darken", low: 0, high: 1, step: 0.01, usual: 0 },
];
const PAIRS = [
  { name: "mask", title: "Specular mask", brightness: 0, contrast: 1 },
  { name: "fresnel", title: "Fresnel", brightness: -0.43, contrast: 0.1 },
];

/**
 * @param {import("./studio_edits.js").Edits} edits
 * @returns {HTMLElement} sliders of which each shows its edit at once
 */
export function controlsPanel(edits) {
  const rows = SINGLE.map(({ name, key, label, low, high, step, usual }) => {
    const made = slider({ label, low, high, step, value: usual, changed: (value) => {
      made.set(value);
      edits.set(name, { [key]: value });
    } });
    edits.on(() => {
      if (!(name in edits.edits)) made.set(usual);
    });
    return made.row;
  });
  return element("div", {}, ...rows, ...PAIRS.map((pair) => brightnessContrast(edits, pair)));
}

function brightnessContrast(edits, { name, title, ...usual }) {
  const values = { ...usual };
  const rows = [["brightness", -1, 1], ["contrast", -2, 4]].map(([key, low, high]) => {
    const label = key[0].toUpperCase() + key.slice(1);
    const made = slider({ label, low, high, step: 0.01, value: usual[key], changed: (value) => {
      values[key] = value;
      made.set(value);
      edits.set(name, { ...values });
    } });
    made.row.querySelectorAll("input").forEach((input) => input.setAttribute("aria-label", `${title}: ${key}`));
    edits.on(() => {
      if (name in edits.edits) return;
      values[key] = usual[key];
      made.set(usual[key]);
    });
    return made.row;
  });
  return element("fieldset", { class: "tms-group" }, element("legend", {}, `${title} from the diffuse brightness`), ...rows);
}

/** Buttons that write what is shown, or take it back. */
export function editButtons(edits, said) {
  const write = element("button", { type: "button", onclick: () => edits.write() }, "Write into the folder");
  const discard = element("button", { type: "button", onclick: () => edits.discard() }, "Take back");
  const follow = () => {
    write.disabled = edits.empty;
    discard.disabled = edits.empty;
  };
  edits.on(follow);
  follow();
  return element("div", {}, element("div", { class: "tmv-buttons" }, write, discard), said);
}
