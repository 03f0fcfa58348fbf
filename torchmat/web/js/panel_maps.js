// The maps of the material: a small picture each, what it is, and its range.

import { element, whenSeen } from "./dom.js";
import { thumbnail } from "./thumbnails.js";

const UNSEEN = 2000; // ms without a large picture: it is out of sight

const number = (value) => String(Number(value.toPrecision(3)));

function extent(entry) {
  const [low, high] = entry.range;
  const bits = { u8: "8 bits", u16: "16 bits", f16: "half floats", f32: "floats" }[entry.type];
  return `${low === high ? number(low) : `${number(low)} to ${number(high)}`}, ${bits}${entry.per_texel ? "" : ", shared by all texels"}`;
}

/** @param {import("./viewing.js").Viewer} viewer @returns {HTMLElement} */
export function mapsPanel(viewer) {
  const list = element("ul", { class: "tmv-maps" });
  const pictures = new Map();
  const paint = (name) => {
    const entry = viewer.description.maps.find((one) => one.name === name);
    if (entry && viewer.buffers[name]) pictures.get(name)?.replaceChildren(thumbnail(entry, viewer.buffers[name]));
  };
  const fill = () => {
    pictures.clear();
    const shown = viewer.description.maps.filter((entry) => entry.height * entry.width > 1 || entry.per_texel);
    list.replaceChildren(...shown.map((entry) => {
      const frame = element("div", { class: "tmv-thumb" });
      pictures.set(entry.name, frame);
      const title = entry.name.replaceAll("_", " ");
      const said = [element("b", {}, title), element("span", {}, entry.meaning), element("small", {}, extent(entry))];
      return element("li", {}, frame, element("div", {}, ...said));
    }));
    list.append(...(viewer.extra.thumbnails ?? []).map(({ name, said, extent: between, uri }) => element("li", {},
      element("div", { class: "tmv-thumb" }, element("img", { src: uri, alt: said })),
      element("div", {}, element("b", {}, name), element("span", {}, said), element("small", {}, between)))));
    // Small pictures are made after the first large one, which is what one waits for.
    setTimeout(() => [...pictures.keys()].forEach(paint), 0);
  };
  const changed = new Set();
  const repaint = whenSeen(list, () => {
    changed.forEach(paint);
    changed.clear();
  });
  let waits = false; // for the large picture, which one looks at first
  const afterPicture = () => {
    if (!waits) return;
    waits = false;
    repaint();
  };
  viewer.on("maps", (name) => {
    if (!name || !pictures.has(name)) return fill();
    changed.add(name);
    waits = true;
    return setTimeout(afterPicture, UNSEEN);
  });
  viewer.on("frame", afterPicture);
  fill();
  return list;
}
