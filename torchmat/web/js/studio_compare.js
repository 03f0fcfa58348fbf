// BTF, material and difference at the measured pair that lies nearest to the light and the view of the picture; and refits.

import { directionOf } from "./camera.js";
import { element, labelled, slider } from "./dom.js";

const number = (value, digits = 3) => (value === null || value === undefined ? "–" : String(Number(value.toPrecision(digits))));
const NAMES = { target: "BTF", fit: "Material", difference: "Difference" };

function figures(table) {
  const rows = [["relative error", number(table.relative_error)], ["PSNR, dB", number(table.psnr_db, 4)]];
  if (table.ssim !== undefined) rows.push(["SSIM", number(table.ssim)]);
  return rows.map(([name, value]) => `${name} ${value}`).join(", ");
}

async function fetchPicture(name, { width, height }) {
  const bytes = new Uint8Array(await (await fetch(`/picture/${name}?t=${performance.now()}`)).arrayBuffer());
  const pixels = new ImageData(width, height);
  for (let at = 0; at < width * height; at += 1) {
    pixels.data.set(bytes.subarray(3 * at, 3 * at + 3), 4 * at);
    pixels.data[4 * at + 3] = 255;
  }
  return pixels;
}

/** @param {import("./viewing.js").Viewer} viewer @param {import("./studio_live.js").Live} live @returns {HTMLElement} */
export function comparePanel(viewer, live) {
  const said = element("p", { class: "tms-caption", role: "status" });
  const canvases = Object.fromEntries(Object.keys(NAMES).map((name) => [name, element("canvas", { class: "tms-picture" })]));
  const three = element("div", { class: "tms-three" }, ...Object.entries(canvases).map(([name, canvas]) => (
    element("figure", {}, canvas, element("figcaption", {}, NAMES[name])))));
  const compare = async () => {
    said.textContent = "The measured pair is looked up.";
    const { view, lights, active } = viewer.state;
    try {
      const found = await live.wish("compare", { light: [...directionOf(lights[active])], view: [...directionOf(view)] });
      const pictures = await Promise.all(Object.keys(NAMES).map((name) => fetchPicture(name, found)));
      Object.values(canvases).forEach((canvas, place) => {
        Object.assign(canvas, { width: found.width, height: found.height });
        canvas.getContext("2d").putImageData(pictures[place], 0, 0);
      });
      const report = found.report.psnr_db === undefined ? "" : ` On all held-out pairs the report has ${figures(found.report)}.`;
      said.textContent = `Sample ${found.sample}: ${found.directions}, ${found.brightness}. Here ${figures(found)}.${report}`;
    } catch (error) {
      said.textContent = error.message;
    }
  };
  const measure = async () => {
    said.textContent = "All held-out pairs are measured.";
    await live.wish("measure").then((found) => {
      said.textContent = `On ${found.samples} held-out pairs the material as it is now has ${figures(found)}.`;
    }, (error) => {
      said.textContent = error.message;
    });
  };
  return element("div", {}, three, said, element("div", { class: "tmv-buttons" },
    element("button", { type: "button", onclick: compare }, "Compare here"),
    element("button", { type: "button", onclick: measure }, "Measure all")));
}

/** @param {import("./viewing.js").Viewer} viewer @param {import("./studio_live.js").Live} live @returns {HTMLElement} */
export function refitPanel(viewer, live) {
  const list = element("div", { class: "tms-checks" });
  const said = element("p", { class: "tms-caption", role: "status" });
  const bar = element("progress", { max: 1, value: 0, hidden: true, "aria-label": "Progress of the refit" });
  const chosen = new Set();
  let effort = 1;
  const made = slider({ label: "Effort", low: 0.05, high: 4, step: 0.05, value: 1, changed: (value) => {
    effort = value;
    made.set(value);
  } });
  const fill = () => list.replaceChildren(...viewer.description.maps.map(({ name }) => {
    const box = element("input", { type: "checkbox", checked: chosen.has(name), onchange: ({ target }) => {
      if (target.checked) chosen.add(name);
      else chosen.delete(name);
    } });
    return element("label", {}, box, name.replaceAll("_", " "));
  }));
  const failed = (error) => {
    said.textContent = error.message;
  };
  const ask = (type, keywords) => () => live.wish(type, keywords?.()).catch(failed);
  const start = element("button", { type: "button", onclick: ask("refit", () => ({ maps: [...chosen], effort })) }, "Fit them anew");
  const cancel = element("button", { type: "button", disabled: true, onclick: ask("cancel") }, "Cancel");
  live.on("job", ({ state, what, share, text, figures: found }) => {
    const running = state === "running";
    [bar.hidden, start.disabled, cancel.disabled] = [!running, running, !running];
    if (running && typeof share === "number") bar.value = share;
    else bar.removeAttribute("value");
    const dB = (value) => `${number(value, 4)} dB`;
    said.textContent = {
      running: what, failed: text, cancelled: "Cancelled; the material stays as it was.",
      done: found && `Done: held-out pairs from ${dB(found.held_out_before)} to ${dB(found.held_out_after)}.`,
    }[state] ?? "";
  });
  viewer.on("maps", (name) => (name ? null : fill()));
  fill();
  return element("div", {}, labelled("Follow", list), made.row, bar, element("div", { class: "tmv-buttons" }, start, cancel), said);
}
