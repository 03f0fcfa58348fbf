// Draw 360: a rotation that runs round the middle of a selection, or round a place that was pressed.

import { element, whenSeen } from "./dom.js";
import { thumbnail } from "./thumbnails.js";

const SIDE = 260;
const LEAST = 0.02; // of the texture: a smaller selection is a press

/**
 * @param {import("./viewing.js").Viewer} viewer
 * @param {import("./studio_edits.js").Edits} edits
 * @returns {HTMLElement}
 */
export function rotationPanel(viewer, edits) {
  const frame = element("div", { class: "tms-select" });
  const box = element("div", { class: "tms-box", hidden: true });
  let from = null;
  let region = null;
  let centre = null;
  const paint = () => {
    const entry = viewer.description.maps.find((one) => one.name === "diffuse") ?? viewer.description.maps[0];
    if (!entry) return;
    const picture = thumbnail(entry, viewer.buffers[entry.name], SIDE);
    picture.classList.add("tms-picture");
    frame.replaceChildren(picture, box);
  };
  const placeOf = (event) => {
    const { left, top, width, height } = frame.getBoundingClientRect();
    const within = (value) => Math.min(1, Math.max(0, value));
    return [within((event.clientX - left) / width), 1 - within((event.clientY - top) / height)]; // v is up
  };
  frame.addEventListener("pointerdown", (event) => {
    from = placeOf(event);
    frame.setPointerCapture(event.pointerId);
    event.preventDefault();
  });
  frame.addEventListener("pointermove", (event) => {
    if (from) select(from, placeOf(event));
  });
  frame.addEventListener("pointerup", (event) => {
    const to = placeOf(event);
    if (from && Math.max(Math.abs(to[0] - from[0]), Math.abs(to[1] - from[1])) < LEAST) {
      [centre, region] = [to, null];
      mark(to[0], to[1], to[0], to[1]);
    } else if (from) {
      select(from, to);
    }
    from = null;
  });
  function select([u, v], [otherU, otherV]) {
    region = [Math.min(u, otherU), Math.min(v, otherV), Math.max(u, otherU), Math.max(v, otherV)];
    centre = null;
    mark(...region);
  }
  function mark(left, bottom, right, top) {
    box.hidden = false;
    Object.assign(box.style, {
      left: `${100 * left}%`, top: `${100 * (1 - top)}%`, width: `${100 * (right - left)}%`, height: `${100 * (top - bottom)}%`,
    });
  }
  const draw = element("button", { type: "button", onclick: () => {
    edits.set("rotation", { centres: centre ? [centre] : [], region: centre ? null : region });
  } }, "Draw 360");
  const all = element("button", { type: "button", onclick: () => {
    [region, centre, box.hidden] = [null, null, true];
  } }, "Select all");
  const repaint = whenSeen(frame, paint);
  viewer.on("maps", (name) => (!name || name === "diffuse" ? repaint() : null));
  paint();
  const words = "Drag a selection, about whose middle the rotation runs, or press a centre.";
  return element("div", {}, frame, element("div", { class: "tmv-buttons" }, draw, all), element("p", { class: "tms-caption" }, words));
}
