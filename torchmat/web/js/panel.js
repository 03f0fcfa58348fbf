// A panel beside the picture: a title that folds its content away.

import { element } from "./dom.js";

/**
 * @param {{side: HTMLElement}} viewer
 * @param {string} title
 * @param {Node} content
 * @param {{open?: boolean, first?: boolean}} options open: unfolded at the start; first: above the others
 * @returns {HTMLDetailsElement}
 */
export function addPanel(viewer, title, content, { open = true, first = false } = {}) {
  const made = element("details", { class: "tmv-panel", open }, element("summary", {}, title), element("div", { class: "tmv-content" }, content));
  if (first) viewer.side.prepend(made);
  else viewer.side.append(made);
  return made;
}
