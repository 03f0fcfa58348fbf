// The lights: which one, of what kind, where, how bright; and the environment.

import { hexOf, linearOf } from "./colours.js";
import { choice, element, labelled, slider } from "./dom.js";
import { MOST_LIGHTS, environmentNames } from "./lights.js";
import { angleRows } from "./panel_view.js";

/** @param {import("./viewing.js").Viewer} viewer @returns {HTMLElement} */
export function lightPanel(viewer) {
  const active = (state) => state.lights[state.active];
  const change = (act) => {
    viewer.touched();
    viewer.change(act);
  };
  const set = (name) => (value) => change((state) => {
    active(state)[name] = value;
  });
  const kind = choice([["directional", "Distant"], ["point", "Point"]], "directional", set("kind"));
  const distance = slider({ label: "Distance", low: 1.1, high: 10, step: 0.1, value: 3, changed: set("distance") });
  const strength = slider({ label: "Strength", low: 0, high: 4, step: 0.05, value: 1, changed: set("strength") });
  const colour = element("input", { type: "color", oninput: (event) => set("colour")(linearOf(event.target.value)) });
  const around = choice([["", "None"], ...environmentNames()], "", (value) => change((state) => {
    state.environment = value;
  }));
  const follow = () => {
    const light = active(viewer.state);
    kind.value = light.kind;
    distance.row.hidden = light.kind !== "point";
    distance.set(light.distance);
    strength.set(light.strength);
    colour.value = hexOf(light.colour);
    around.value = viewer.state.environment;
  };
  viewer.on("change", follow);
  follow();
  return element("div", {}, lightTabs(viewer), labelled("Kind", kind), ...angleRows(viewer, "light", active), distance.row, strength.row,
    labelled("Colour", colour), labelled("Environment", around));
}

function lightTabs(viewer) {
  const tabs = element("div", { class: "tmv-tabs", role: "group", "aria-label": "Which light" });
  let shown = "";
  const follow = () => {
    const { lights, active } = viewer.state;
    if (shown === `${lights.length}/${active}`) return;
    shown = `${lights.length}/${active}`;
    const button = (title, label, act, pressed = null) => {
      const made = element("button", { type: "button", "aria-label": label, "aria-pressed": pressed, onclick: act }, title);
      return made;
    };
    const choose = (place) => () => viewer.change((state) => {
      state.active = place;
    });
    const focused = tabs.contains(document.activeElement) ? document.activeElement.getAttribute("aria-label") : null;
    tabs.replaceChildren(
      ...lights.map((_, place) => button(String(place + 1), `Light ${place + 1}`, choose(place), String(place === active))),
      ...(lights.length < MOST_LIGHTS ? [button("+", "Add a light", () => viewer.addLight())] : []),
      ...(lights.length > 1 ? [button("−", "Take this light away", () => viewer.removeLight())] : []),
    );
    if (focused) (tabs.querySelector(`[aria-label="${focused}"]`) ?? tabs.firstChild).focus();
  };
  viewer.on("change", follow);
  follow();
  return tabs;
}
