// A viewer in an element of a page: the picture and its panels.

import { element } from "./dom.js";
import { readEmbedded } from "./embedded.js";
import { buildPanels } from "./panels.js";
import { Viewer } from "./viewing.js";

/**
 * Show a material in an element.
 * @param {HTMLElement} root
 * @param {{data?: {description: object, buffers: Record<string, ArrayBuffer>, extra?: object}, live?: boolean, embedded?: boolean,
 *   mesh?: string, intro?: boolean, kind?: typeof Viewer}} options data: what to show, by default what the page holds
 * @returns {Promise<Viewer>} its `scene` is null where only pictures can be shown
 */
export async function mount(root, options = {}) {
  const data = options.data ?? await readEmbedded(document);
  const viewer = new (options.kind ?? Viewer)(root, data, options);
  root.viewer = viewer;
  root.classList.add("tmv");
  const canvas = element("canvas", { tabindex: 0, role: "application", "aria-roledescription": "interactive picture" });
  viewer.stage = element("div", { class: "tmv-stage" }, canvas);
  viewer.side = element("div", { class: "tmv-side" });
  viewer.status = element("div", { class: "tmv-unseen", role: "status" });
  viewer.stills = [...root.querySelectorAll(".tmv-stills")];
  root.classList.toggle("tmv-within", viewer.embedded);
  root.replaceChildren(element("div", { class: "tmv-body" }, viewer.stage, viewer.side), viewer.status);
  try {
    viewer.begin(canvas);
  } catch (error) {
    viewer.scene = null;
    viewer.fail(error);
  }
  buildPanels(viewer);
  viewer.name();
  viewer.redraw();
  if (options.intro && viewer.scene) viewer.introduce();
  return viewer;
}
