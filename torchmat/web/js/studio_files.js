// Which file is which texture, and of which textures saves are shown at once.

import { choice, element } from "./dom.js";

/**
 * Files that can stand for a texture: those whose names hold its word, or all where none does.
 * @param {string} texture such as "specular_2"
 * @param {string[]} pictures names of files
 * @param {string} own the file that it is now
 * @returns {string[]}
 */
export function candidates(texture, pictures, own) {
  const word = texture.replace(/_\d+$/, "").toLowerCase();
  const fitting = pictures.filter((file) => file.toLowerCase().includes(word));
  const shown = fitting.some((file) => file !== own) || fitting.includes(own) ? fitting : pictures;
  return shown.includes(own) ? shown : [own, ...shown];
}

/** @param {import("./studio_live.js").Live} live @returns {HTMLElement} */
export function filesPanel(live) {
  const list = element("div", { class: "tms-files" });
  const said = element("p", { class: "tms-error", role: "status" });
  let still = [];
  let files = { textures: {}, pictures: [] };
  const ask = (type, keywords) => {
    said.textContent = "";
    live.wish(type, keywords).catch((error) => {
      said.textContent = error.message;
      fill();
    });
  };
  live.on("hello", (hello) => {
    ({ still } = hello);
    files = hello;
    fill();
  });
  live.on("files", (news) => {
    files = news;
    fill();
  });
  live.on("still", (news) => {
    ({ still } = news);
    fill();
  });

  function fill() {
    list.replaceChildren(...Object.entries(files.textures).map(([texture, file]) => {
      const options = candidates(texture, files.pictures, file).map((one) => [one, one]);
      const chosen = choice(options, file, (other) => ask("choose", { texture, file: other }));
      chosen.setAttribute("aria-label", `File of ${texture}`);
      const follow = element("input", {
        type: "checkbox", checked: !still.includes(texture), "aria-label": `Show saves of ${texture} at once`,
        onchange: (event) => ask("follow", { texture, on: event.target.checked }),
      });
      const title = element("span", {}, texture.replaceAll("_", " "));
      return element("div", { class: "tms-file" }, title, chosen, element("label", {}, follow, "update"));
    }));
  }
  return element("div", {}, list, said);
}
