// The panels that come with the viewer.

import { HELP } from "./controls.js";
import { element } from "./dom.js";
import { addPanel } from "./panel.js";
import { lightPanel } from "./panel_light.js";
import { mapsPanel } from "./panel_maps.js";
import { objectPanel } from "./panel_object.js";
import { viewPanel } from "./panel_view.js";

/** @param {import("./viewing.js").Viewer} viewer */
export function buildPanels(viewer) {
  const wide = viewer.root.getBoundingClientRect().width >= 720;
  if (viewer.scene) {
    addPanel(viewer, "View", viewPanel(viewer));
    addPanel(viewer, "Light", lightPanel(viewer));
    addPanel(viewer, "Object", objectPanel(viewer), { open: wide });
  }
  if (viewer.description.maps?.length) addPanel(viewer, "Maps", mapsPanel(viewer), { open: wide });
  if (viewer.extra.errors) addPanel(viewer, "How true it is", errorsPanel(viewer.extra.errors), { open: wide });
  if (viewer.extra.notes?.length) {
    addPanel(viewer, "What is shown", element("ul", {}, ...viewer.extra.notes.map((note) => element("li", {}, note))), { open: wide });
  }
  if (viewer.scene) addPanel(viewer, "Keys and gestures", helpPanel(), { open: false });
}

/** @param {{caption: string, columns: string[], rows: string[][]}} errors */
function errorsPanel({ caption, columns, rows }) {
  const cells = (tag, row) => row.map((cell, at) => element(at ? tag : "th", { scope: tag === "th" ? "col" : at ? null : "row" }, cell));
  return element("table", { class: "tmv-table" }, element("caption", {}, caption),
    element("thead", {}, element("tr", {}, ...cells("th", ["", ...columns]))),
    element("tbody", {}, ...rows.map((row) => element("tr", {}, ...cells("td", row)))));
}

function helpPanel() {
  const rows = HELP.map(([keys, act]) => element("tr", {}, element("th", { scope: "row" }, keys), element("td", {}, act)));
  return element("table", { class: "tmv-table tmv-help" }, element("tbody", {}, ...rows));
}
