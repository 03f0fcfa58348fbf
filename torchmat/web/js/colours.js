// Colours of a page as numbers.

/** What may stand behind the object; "page" is what the page has there. */
export const BACKGROUNDS = [["page", "As the page"], ["#000000", "Black"], ["#777777", "Grey"], ["#ffffff", "White"]];

const linear = (code) => (code <= 0.04045 ? code / 12.92 : ((code + 0.055) / 1.055) ** 2.4);
const encoded = (value) => (value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055);

/**
 * @param {string} chosen "page", or "#rrggbb"
 * @param {HTMLElement} place whose page it is
 * @returns {number[]} linear RGB
 */
export function shownColour(chosen, place) {
  if (chosen !== "page") return linearOf(chosen);
  const found = getComputedStyle(place.parentElement).backgroundColor.match(/[\d.]+/g)?.map(Number) ?? [0, 0, 0, 0];
  return found.length === 4 && found[3] === 0 ? [0, 0, 0] : found.slice(0, 3).map((one) => linear(one / 255));
}

/** @param {string} colour "#rrggbb" @returns {number[]} linear RGB */
export function linearOf(colour) {
  return [1, 3, 5].map((at) => linear(parseInt(colour.slice(at, at + 2), 16) / 255));
}

/** @param {number[]} rgb linear @returns {string} "#rrggbb" */
export function hexOf(rgb) {
  return `#${rgb.map((one) => Math.round(255 * encoded(Math.min(1, Math.max(0, one)))).toString(16).padStart(2, "0")).join("")}`;
}
