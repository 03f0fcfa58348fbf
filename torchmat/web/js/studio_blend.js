// On the way to another material: shown at once, written when asked for.

import { choice, element, labelled, slider } from "./dom.js";

/** @param {import("./studio_live.js").Live} live @param {string[]} others @returns {HTMLElement} */
export function blendPanel(live, others) {
  const said = element("p", { class: "tms-error", role: "status" });
  let [other, weight, again, asking] = [0, 0, false, null];
  const tell = (error) => {
    said.textContent = error?.message ?? "";
  };
  const ask = async () => {
    while (again) {
      again = false;
      await live.wish("blend", { other, weight }).then(() => tell(null), tell);
    }
    asking = null;
  };
  const show = () => {
    again = true;
    asking ??= ask();
  };
  const chosen = choice(others.map((name, place) => [String(place), name]), "0", (value) => {
    other = Number(value);
    show();
  });
  const made = slider({ label: "Weight", low: 0, high: 1, step: 0.01, value: 0, changed: (value) => {
    weight = value;
    made.set(value);
    show();
  } });
  const write = element("button", { type: "button", onclick: async () => {
    await asking;
    await live.wish("apply_blend", { other, weight }).then(() => tell(null), tell);
    weight = 0;
    made.set(0);
  } }, "Write into the folder");
  const discard = element("button", { type: "button", onclick: () => {
    weight = 0;
    made.set(0);
    live.wish("discard").catch(tell);
  } }, "Take back");
  return element("div", {}, labelled("With", chosen), made.row, element("div", { class: "tmv-buttons" }, write, discard), said);
}
