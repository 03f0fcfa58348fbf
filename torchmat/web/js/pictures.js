// What is shown where the material's shader cannot run: pictures that were made with the page.

import { element } from "./dom.js";

/** Of a model whose value no shader computes. */
export class NoShader extends Error {}

const NO_SHADER = "This kind of material has no shader: these pictures were made with the page.";
const NO_WEBGL = "This browser draws no WebGL 2, in which the material moves. These pictures were made with the page.";

/**
 * @param {HTMLElement} stage where the picture would be
 * @param {Error} error why there is none
 * @param {HTMLElement[]} stills elements of the page that hold pictures
 */
export function showPictures(stage, error, stills) {
  const pictured = stills.filter((still) => still.childElementCount > 0);
  const said = error instanceof NoShader ? NO_SHADER : pictured.length ? NO_WEBGL : `${NO_WEBGL.split(". ")[0]}.`;
  stage.classList.add("tmv-still");
  stage.replaceChildren(element("p", { role: "note" }, said), ...pictured);
}
