// What is shown where the material's shader cannot run: pictures that were made with the page.

import { element } from "./dom.js";

const SAID = {
  NoWebGL2: "This browser has no WebGL 2, which draws the material as it moves. These pictures were made with the page.",
  NoShader: "This kind of material has no shader: these pictures were made with the page.",
};

/**
 * @param {HTMLElement} stage where the picture would be
 * @param {Error} error why there is none
 * @param {HTMLElement[]} stills elements of the page that hold pictures
 */
export function showPictures(stage, error, stills) {
  const kept = stills.map((still) => {
    still.removeAttribute("hidden");
    return still;
  });
  stage.classList.add("tmv-still");
  const none = kept.length ? "" : " The page holds none.";
  stage.replaceChildren(element("p", { role: "note" }, SAID[error.name] + none), ...kept);
}
