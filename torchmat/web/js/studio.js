// The studio's page: the viewer, live, and the studio's panels.

import { Live, fetchMaterial } from "./studio_live.js";
import { filesPanel } from "./studio_files.js";
import { historyPanel } from "./studio_history.js";
import { mount } from "./viewer.js";

/**
 * Start the studio in an element of the page.
 * @param {HTMLElement} root
 * @returns {Promise<{live: Live, viewer: import("./viewing.js").Viewer}>}
 */
export async function start(root) {
  window.history.replaceState(null, "", "/"); // the token is a cookie by now, and need not be seen
  const live = new Live();
  const { versions, ...data } = await fetchMaterial();
  const viewer = await mount(root, { data, live: true });
  live.show(viewer, versions);
  const first = viewer.on("frame", () => {
    first();
    studioDrawn(live);
  });
  viewer.addPanel("Saves and undo", historyPanel(live), { first: true });
  viewer.addPanel("Files", filesPanel(live), { open: false });
  return { live, viewer };
}

/** Say that the first picture is there: what is loaded after it waits for that. */
function studioDrawn(live) {
  window.torchmatDrawn = performance.now();
  live.wish("drawn").catch(() => setTimeout(() => live.wish("drawn").catch(() => {}), 300));
}

const root = document.getElementById("torchmat-viewer");
start(root).then((studio) => {
  window.torchmat = studio; // for the console, and for tests
}, (error) => {
  root.replaceChildren(`The studio could not start: ${error.message}`);
  throw error;
});
