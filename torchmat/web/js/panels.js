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
  // Within a longer page, that stands there too; on a phone it would be far to scroll.
  const wide = viewer.root.getBoundingClientRect().width >= 720;
  const first = { open: wide || !viewer.embedded };
  const later = { open: wide && !viewer.embedded };
  if (viewer.scene) {
    addPanel(viewer, "View", viewPanel(viewer), first);
    addPanel(viewer, "Light", lightPanel(viewer), first);
    addPanel(viewer, "Object", objectPanel(viewer), later);
  }
  if (viewer.description.maps?.length) addPanel(viewer, "Maps", mapsPanel(viewer), later);
  if (viewer.extra.errors) addPanel(viewer, "How true it is", errorsPanel(viewer.extra.errors), later);
  if (viewer.extra.notes?.length) {
    addPanel(viewer, "What is shown", element("ul", {}, ...viewer.extra.notes.map((note) => element("li", {}, note))), later);
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
