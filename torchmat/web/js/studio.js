// The studio's page: the viewer, live, and the studio's panels.

import { element } from "./dom.js";
import { blendPanel } from "./studio_blend.js";
import { comparePanel, refitPanel } from "./studio_compare.js";
import { controlsPanel, editButtons } from "./studio_controls.js";
import { Edits } from "./studio_edits.js";
import { filesPanel } from "./studio_files.js";
import { historyPanel } from "./studio_history.js";
import { Live, fetchMaterial } from "./studio_live.js";
import { nineViews } from "./studio_nine.js";
import { PicturedViewer } from "./studio_pictured.js";
import { rotationPanel } from "./studio_rotation.js";
import { tiltPanel } from "./studio_tilt.js";
import { mount } from "./viewer.js";

const REMEMBERED = 1000; // milliseconds of rest until the way it is looked at is kept

/**
 * Start the studio in an element of the page.
 * @param {HTMLElement} root
 * @returns {Promise<{live: Live, viewer: import("./viewing.js").Viewer}>}
 */
export async function start(root) {
  window.history.replaceState(null, "", "/"); // the token is a cookie by now, and need not be seen
  const live = new Live();
  const { versions, ...data } = await fetchMaterial();
  const drawn = Boolean(data.description.glsl);
  const { errors } = data.description;
  const viewer = await mount(root, drawn ? { data, live: true } : { data: { ...data, extra: { errors } }, live: true, ...picturedBy(live) });
  live.show(viewer, versions);
  const first = viewer.on("frame", () => {
    first();
    studioDrawn(live);
  });
  const help = viewer.side.lastElementChild;
  viewer.addPanel("Files", filesPanel(live), { open: false });
  const studio = { live, viewer };
  if (viewer.context) {
    studio.nine = nineViews(viewer);
    const panel = addFolded(viewer, "Nine views", studio.nine.element, () => studio.nine.opened());
    addExpand(viewer, panel);
  }
  addEdits(studio);
  const hello = await live.hello;
  if (hello.others.length && drawn) addFolded(viewer, "Blend", blendPanel(live, hello.others));
  if (hello.measured) {
    addFolded(viewer, "Beside the BTF", comparePanel(viewer, live));
    if (drawn) addFolded(viewer, "Fit maps anew", refitPanel(viewer, live));
  }
  viewer.addPanel("Saves and undo", historyPanel(live), { first: true });
  if (!drawn) viewer.on("failed", (error) => live.emit("problem", error));
  viewer.side.append(help); // the keys come last
  remember(live, viewer, hello.look);
  return studio;
}

/** What mounts a viewer of a material that no shader draws. */
function picturedBy(live) {
  const pictures = async (look) => {
    await live.hello;
    return live.wish("picture", look);
  };
  return { kind: PicturedViewer, pictures };
}

function addFolded(viewer, title, content, opened = () => {}) {
  const panel = viewer.addPanel(title, content, { open: false });
  panel.addEventListener("toggle", (event) => event.target.open && opened());
  return panel;
}

/** The controls that change maps; only the artist's material has those. */
function addEdits(studio) {
  const { viewer, live } = studio;
  if (viewer.description.model !== "distribution") return;
  const said = element("p", { class: "tms-error", role: "status" });
  studio.edits = new Edits(live, (error) => {
    said.textContent = error?.message ?? "";
  });
  addFolded(viewer, "Controls", controlsPanel(studio.edits));
  addFolded(viewer, "Tilt curve", tiltPanel(studio.edits));
  addFolded(viewer, "Rotation: draw 360", rotationPanel(viewer, studio.edits));
  viewer.addPanel("Edits", editButtons(studio.edits, said), { first: true });
}

/** A button on the picture that hides the nine views and brings them back; the picture and all other panels stay. */
function addExpand(viewer, panel) {
  const button = element("button", { type: "button", class: "tms-expand", onclick: () => {
    panel.open = !panel.open;
    if (panel.open) panel.scrollIntoView({ block: "nearest" });
  } }, "Expand");
  const follow = () => {
    button.setAttribute("aria-expanded", String(panel.open));
    button.title = panel.open ? "Hide the nine views" : "Bring the nine views back";
    button.textContent = panel.open ? "Expand" : "Nine views";
  };
  panel.addEventListener("toggle", follow);
  follow();
  viewer.canvas.parentElement.append(button);
}

/** Bring back how the material was looked at, and keep how it is. */
function remember(live, viewer, look) {
  const kept = ({ mesh, view, lights, active, environment, repeat, exposure, background }) => (
    { mesh, view, lights, active, environment, repeat, exposure, background });
  if (look.state && viewer.scene) {
    if (viewer.meshes.includes(look.state.mesh)) viewer.setMesh(look.state.mesh);
    viewer.change((state) => Object.assign(state, kept({ ...state, ...look.state })));
  }
  let timer = 0;
  viewer.on("change", () => {
    clearTimeout(timer);
    timer = setTimeout(() => live.wish("remember", { look: { state: kept(viewer.state) } }).catch(() => {}), REMEMBERED);
  });
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
