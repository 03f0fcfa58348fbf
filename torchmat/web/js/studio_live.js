// The line between a page and its studio: maps come in as they are saved, wishes go out, and each has its answer.

const AGAIN = 1000; // milliseconds until a lost connection is tried again
const TYPES_OF_NEWS = ["hello", "history", "files", "says", "still", "job"];

/** @returns {Promise<{description: object, buffers: Record<string, ArrayBuffer>, versions: Record<string, number>}>} what is shown now */
export async function fetchMaterial(known = { versions: {}, buffers: {} }) {
  const answer = await fetch("/material.json");
  if (!answer.ok) throw new Error(await answer.text());
  const { versions, ...description } = await answer.json();
  const buffers = {};
  const read = {};
  await Promise.all(Object.keys(versions).map(async (name) => {
    if (known.versions[name] === versions[name]) {
      [buffers[name], read[name]] = [known.buffers[name], versions[name]];
      return;
    }
    const map = await fetchMap(name, versions[name]);
    [buffers[name], read[name]] = [map.buffer, map.version];
    description.maps = description.maps.map((entry) => (entry.name === name ? map.entry : entry));
  }));
  return { description, buffers, versions: read };
}

/** @returns {Promise<{version: number, entry: object, buffer: ArrayBuffer}>} one map, at least as new as `version` */
async function fetchMap(name, version) {
  const answer = await fetch(`/map/${name}?v=${version}`);
  if (!answer.ok) throw new Error(await answer.text());
  const buffer = await answer.arrayBuffer();
  return { ...JSON.parse(answer.headers.get("x-map")), buffer };
}

/** A connection to the studio that made the page; it comes back when it was lost. */
export class Live {
  constructor() {
    this.listeners = new Map();
    this.answers = new Map();
    this.count = 0;
    this.news = new Map();
    this.material = null;
    this.versions = {};
    this.wanted = new Map();
    this.fetching = new Set();
    this.hello = new Promise((resolve) => this.on("hello", resolve)); // the first one
    this.connect();
  }

  connect() {
    this.socket = new WebSocket(`ws://${location.host}/live`);
    this.socket.addEventListener("message", (event) => this.heard(JSON.parse(event.data)));
    this.socket.addEventListener("close", () => this.lost());
  }

  lost() {
    this.answers.forEach(({ reject }) => reject(new Error("The studio does not answer: it was ended, or is starting again.")));
    this.answers.clear();
    this.emit("lost");
    setTimeout(() => this.connect(), AGAIN);
  }

  /** @param {string} kind of message, or "lost" @param {(message: object) => void} listener hears the last one at once */
  on(kind, listener) {
    if (!this.listeners.has(kind)) this.listeners.set(kind, new Set());
    this.listeners.get(kind).add(listener);
    if (this.news.has(kind)) listener(this.news.get(kind));
  }

  emit(kind, message) {
    this.listeners.get(kind)?.forEach((listener) => listener(message));
  }

  heard(message) {
    const { type } = message;
    if (type === "answer") {
      const waiting = this.answers.get(message.id);
      this.answers.delete(message.id);
      if (message.error) waiting?.reject(new Error(message.error));
      else waiting?.resolve(message.value);
      return;
    }
    if (TYPES_OF_NEWS.includes(type) && type !== "says") this.news.set(type, message);
    if (type === "map") this.mapSaved(message.name, message.version);
    else if (type === "material") this.materialSaved();
    else this.emit(type, message);
    if (type !== "hello" || !this.viewer) return;
    // After a lost connection anything may have changed.
    if (Object.keys({ ...message.versions, ...this.versions }).some((name) => message.versions[name] !== this.versions[name])) this.materialSaved();
  }

  /**
   * Ask the studio for something.
   * @param {string} type as torchmat/studio/wishes.py has them
   * @param {object} keywords
   * @returns {Promise<any>} its answer; rejects with what it says is wrong
   */
  wish(type, keywords = {}) {
    this.count += 1;
    const id = this.count;
    if (this.socket.readyState !== WebSocket.OPEN) return Promise.reject(new Error("The studio does not answer."));
    this.socket.send(JSON.stringify({ type, id, ...keywords }));
    return new Promise((resolve, reject) => this.answers.set(id, { resolve, reject }));
  }

  /** @param {import("./viewing.js").Viewer} viewer what shows the material from now on */
  show(viewer, versions) {
    this.viewer = viewer;
    this.versions = versions;
    const { versions: now } = this.news.get("hello") ?? { versions };
    for (const [name, version] of Object.entries(now)) if (version > (versions[name] ?? 0)) this.mapSaved(name, version);
  }

  /** Fetch a map that was saved; what is saved meanwhile is fetched once more after that, and not more often. */
  async mapSaved(name, version) {
    this.wanted.set(name, version);
    if (!this.viewer || this.fetching.has(name)) return;
    this.fetching.add(name);
    try {
      while (this.wanted.get(name) > (this.versions[name] ?? 0)) {
        const map = await fetchMap(name, this.wanted.get(name));
        this.versions[name] = map.version;
        if (this.viewer.description.maps.some((one) => one.name === name)) this.viewer.updateMap(name, map.entry, map.buffer);
      }
    } catch (error) {
      this.emit("problem", error);
    } finally {
      this.fetching.delete(name);
    }
  }

  /** Fetch all that is another after a change of more than maps. */
  async materialSaved() {
    this.again = true;
    if (!this.viewer || this.loading) return;
    this.loading = true;
    try {
      while (this.again) {
        this.again = false;
        const found = await fetchMaterial({ versions: this.versions, buffers: this.viewer.buffers });
        // Of another kind: drawn here now, or by the studio.
        if (!found.description.glsl !== !this.viewer.description.glsl) return location.reload();
        this.versions = found.versions;
        this.viewer.setMaterial(found.description, found.buffers);
        this.emit("material");
      }
    } catch (error) {
      this.emit("problem", error);
    } finally {
      this.loading = false;
    }
  }
}
