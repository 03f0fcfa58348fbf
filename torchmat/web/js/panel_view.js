// The view's angles and distance.

import { choice, element, labelled, slider } from "./dom.js";

/** The two angles of a view or a light, each with a button that sweeps it. */
export function angleRows(viewer, whose, read) {
  const rows = [["theta", "θ", -180, 180], ["phi", "φ", 0, 360]].map(([angle, sign, low, high]) => {
    const name = `${whose}.${angle}`;
    const button = element("button", {
      type: "button", class: "tmv-sweep", title: "Let it sweep", "aria-label": `Sweep the ${whose}'s ${angle}`, "aria-pressed": "false",
      onclick: () => {
        viewer.touched();
        viewer.toggleSweep(name);
      },
    }, "▶");
    const made = slider({
      label: `${sign}, degrees`, low, high, step: 1, value: 0, extra: button,
      changed: (value) => {
        viewer.touched();
        viewer.change((state) => {
          read(state)[angle] = value;
        });
      },
    });
    made.row.querySelectorAll("input").forEach((input) => input.setAttribute("aria-label", `${whose} ${angle}, degrees`));
    viewer.on("change", (state) => {
      made.set(read(state)[angle]);
      const swept = state.sweeps.includes(name);
      button.setAttribute("aria-pressed", String(swept));
      button.textContent = swept ? "❚❚" : "▶";
    });
    made.set(read(viewer.state)[angle]);
    return made.row;
  });
  return rows;
}

/** @param {import("./viewing.js").Viewer} viewer @returns {HTMLElement} */
export function viewPanel(viewer) {
  const zoom = slider({
    label: "Distance", low: 0.125, high: 4, step: 0.01, value: 1,
    changed: (value) => viewer.change((state) => {
      state.view.zoom = 1 / value;
    }),
  });
  const kind = choice([["far", "Far away"], ["near", "Perspective"]], "far", (value) => viewer.change((state) => {
    state.view.perspective = value === "near";
  }));
  viewer.on("change", (state) => {
    zoom.set(1 / state.view.zoom);
    kind.value = state.view.perspective ? "near" : "far";
  });
  const reset = element("button", { type: "button", onclick: () => {
    viewer.touched();
    viewer.reset();
  } }, "Start again");
  return element("div", {}, ...angleRows(viewer, "view", (state) => state.view), zoom.row, labelled("Camera", kind),
    element("div", { class: "tmv-buttons" }, reset));
}
