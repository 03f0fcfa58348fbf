// What is shown where the material's shader cannot run: pictures that were made with the page.

import { element } from "./dom.js";
import { NoWebGL2 } from "./gl.js";

/** Of a model whose value no shader computes. */
export class NoShader extends Error {}

function said(error) {
  if (error instanceof NoShader) return "This kind of material has no shader.";
  if (error instanceof NoWebGL2) return "This browser draws no WebGL 2, in which the material moves.";
  return `The material could not be drawn here. ${error.message}`;
}

/**
 * @param {HTMLElement} stage where the picture would be
 * @param {Error} error why there is none
 * @param {HTMLElement[]} stills elements of the page that hold pictures
 */
export function showPictures(stage, error, stills) {
  const pictured = stills.filter((still) => still.childElementCount > 0);
  const more = pictured.length ? " These pictures were made with the page." : "";
  stage.classList.add("tmv-still");
  stage.replaceChildren(element("p", { role: "note" }, said(error) + more), ...pictured);
}
