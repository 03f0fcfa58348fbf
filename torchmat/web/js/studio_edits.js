// Edits that are looked at before they are written: the newest is shown, and what came before it is skipped.

/** The edits that were asked for and are not written yet, by name as `torchmat edit` has them. */
export class Edits {
  /** @param {import("./studio_live.js").Live} live @param {(error: Error | null) => void} said hears what is wrong */
  constructor(live, said) {
    Object.assign(this, { live, said, edits: {}, drop: [], listeners: new Set(), again: false, asking: null });
  }

  get empty() {
    return !Object.keys(this.edits).length && !this.drop.length;
  }

  /** @param {() => void} listener hears when edits came or went */
  on(listener) {
    this.listeners.add(listener);
  }

  /** Show an edit. @param {string} name such as "mask" @param {object} keywords of torchmat/create/edits.py */
  set(name, keywords) {
    this.edits[name] = keywords;
    this.changed();
  }

  changed() {
    this.listeners.forEach((listener) => listener());
    this.again = true;
    this.asking ??= this.ask();
  }

  async ask() {
    while (this.again) {
      this.again = false;
      try {
        if (this.empty) await this.live.wish("discard");
        else await this.live.wish("preview", { edits: this.edits, drop: this.drop });
        this.said(null);
      } catch (error) {
        this.said(error);
      }
    }
    this.asking = null;
  }

  /** Write them into the folder. */
  async write() {
    const { edits, drop } = this;
    this.forget();
    await this.asking;
    try {
      const { backup } = await this.live.wish("apply", { edits, drop });
      this.said(backup ? new Error(`What was painted and is written anew is kept in ${backup}`) : null);
    } catch (error) {
      this.said(error);
      await this.live.wish("discard").catch(() => {});
    }
  }

  /** Show the folder as it is. */
  discard() {
    this.forget();
    this.changed();
  }

  forget() {
    Object.assign(this, { edits: {}, drop: [] });
    this.listeners.forEach((listener) => listener());
  }
}
