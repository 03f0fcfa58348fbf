// The tilt curve: how the highlight grows toward grazing, drawn by points; the default is that of the formula, exactly.

import { element, freshId } from "./dom.js";

const [WIDE, HIGH, EDGE] = [300, 130, 8];
const SVG = "http" + "://www.w3.org/2000/svg"; // the name of a language, nothing that is fetched
const REACH = 14;
const STEPS = 90;

const shape = (tag, attributes) => {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
};
const across = (degrees) => EDGE + (degrees / 90) * (WIDE - 2 * EDGE);
const down = (tilt) => HIGH - EDGE - tilt * (HIGH - 2 * EDGE);

/** @param {number} degrees @returns {number} what the default is there, 1 - cos */
export const usualTilt = (degrees) => 1 - Math.cos(degrees * Math.PI / 180);

/** @param {import("./studio_edits.js").Edits} edits @returns {HTMLElement} */
export function tiltPanel(edits) {
  let points = null; // none: the default
  const drawing = shape("svg", { viewBox: `0 0 ${WIDE} ${HIGH}`, class: "tms-curve", role: "img", tabindex: 0 });
  const id = freshId();
  drawing.setAttribute("aria-describedby", id);
  const line = shape("polyline", { fill: "none", stroke: "currentColor", "stroke-width": 2 });
  const dots = shape("g", { fill: "currentColor" });
  drawing.append(shape("rect", { x: EDGE, y: EDGE, width: WIDE - 2 * EDGE, height: HIGH - 2 * EDGE, class: "tms-frame" }), line, dots);

  const show = () => {
    const samples = points ?? Array.from({ length: STEPS + 1 }, (_, degrees) => [degrees, usualTilt(degrees)]);
    const whole = points ? [[0, points[0][1]], ...points, [90, points.at(-1)[1]]] : samples;
    line.setAttribute("points", whole.map(([degrees, tilt]) => `${across(degrees)},${down(tilt)}`).join(" "));
    dots.replaceChildren(...(points ?? []).map(([degrees, tilt]) => shape("circle", { cx: across(degrees), cy: down(tilt), r: 5 })));
    drawing.setAttribute("aria-label", points ? `Tilt through ${points.length} points` : "Tilt 1 minus cosine");
  };
  const send = () => edits.set("tilt", { curve: points ?? "default" });
  const placeOf = (event) => {
    const box = drawing.getBoundingClientRect();
    const [x, y] = [(event.clientX - box.left) * WIDE / box.width, (event.clientY - box.top) * HIGH / box.height];
    const within = (value, most) => Math.min(most, Math.max(0, value));
    const [degrees, tilt] = [(x - EDGE) / (WIDE - 2 * EDGE) * 90, (HIGH - EDGE - y) / (HIGH - 2 * EDGE)];
    return [within(Math.round(degrees), 90), within(Math.round(100 * tilt) / 100, 1)];
  };
  let held = -1;
  drawing.addEventListener("pointerdown", (event) => {
    points ??= [0, 30, 60, 90].map((degrees) => [degrees, Math.round(100 * usualTilt(degrees)) / 100]);
    const place = placeOf(event);
    held = points.findIndex(([degrees, tilt]) => Math.hypot(across(degrees) - across(place[0]), down(tilt) - down(place[1])) < REACH);
    if (event.altKey && held >= 0 && points.length > 1) {
      points.splice(held, 1);
      held = -1;
    } else if (held < 0 && !points.some(([degrees]) => degrees === place[0])) {
      points = [...points, place].sort(([one], [other]) => one - other);
      held = points.indexOf(place);
    }
    drawing.setPointerCapture(event.pointerId);
    show();
    send();
  });
  drawing.addEventListener("pointermove", (event) => {
    if (held < 0) return;
    const [degrees, tilt] = placeOf(event);
    // A point stays between its neighbours, for each angle has one tilt.
    const [before, after] = [points[held - 1]?.[0] ?? -1, points[held + 1]?.[0] ?? 91];
    points[held] = [Math.min(after - 1, Math.max(before + 1, degrees)), tilt];
    show();
    send();
  });
  for (const name of ["pointerup", "pointercancel"]) {
    drawing.addEventListener(name, () => {
      held = -1;
    });
  }
  const usual = element("button", { type: "button", onclick: () => {
    points = null;
    show();
    send();
  } }, "Default: 1 − cos θ");
  edits.on(() => {
    if ("tilt" in edits.edits) return;
    points = null;
    show();
  });
  show();
  const words = "0 to 90 degrees across, tilt 0 to 1 up. Press to add a point, drag it, alt and press to take it away.";
  return element("div", {}, drawing, element("div", { class: "tmv-buttons" }, usual), element("p", { class: "tms-caption", id }, words));
}
