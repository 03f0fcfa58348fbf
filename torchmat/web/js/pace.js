// How finely to draw: as finely as the graphics processor keeps up with while something moves, and at rest in full if that is not for ever.

const MOVING = 30; // milliseconds that a picture may take while something moves
const RESTING = 3000; // and at rest
const LEAST = 0.25;
const REST = 220; // milliseconds without a change until the finest picture is drawn
// A save must not wait for a finest picture: where saves come in, a finer one that takes this long does at first, and the finest one
// is drawn when this long nothing has changed.
const FINER = 60;
const SETTLED = 2000;
const LIVE = 600; // milliseconds that the finest picture may take there
const LONGEST = 10000; // without an answer for so long no more is expected
const POLL = 6;

const shareFor = (most, whole) => Math.max(LEAST, Math.min(1, Math.sqrt(most / whole)));

/** Watches how long pictures take. */
export class Pace {
  /**
   * @param {WebGL2RenderingContext} gl
   * @param {() => void} rested called when a finer picture is due
   * @param {boolean} live whether saves come in
   */
  constructor(gl, rested, live = false) {
    this.gl = gl;
    this.rested = rested;
    this.live = live;
    this.resting = live ? FINER : RESTING; // milliseconds that a picture at rest may take for now
    // Milliseconds of a picture in full: a guess until the first was timed; where saves come in, that it is as slow as can be.
    this.whole = live ? LIVE / LEAST ** 2 : 6 * MOVING;
    this.moving = false;
    this.pictures = 0; // that were drawn
    this.sync = null;
    this.sentShare = 0;
    this.timers = {};
  }

  /** Something changed: coarse pictures will do until it rests. */
  stir() {
    this.moving = true;
    clearTimeout(this.timers.rest);
    clearTimeout(this.timers.settled);
    this.timers.rest = setTimeout(() => this.rest(this.live ? FINER : RESTING), REST);
    if (this.live) this.timers.settled = setTimeout(() => this.rest(LIVE), SETTLED);
  }

  rest(most) {
    Object.assign(this, { moving: false, resting: most });
    if (this.coarse) this.rested();
  }

  /** @returns {number} the factor on the pixels' number along a side of the next picture */
  share() {
    return shareFor(this.moving ? MOVING : this.resting, this.whole);
  }

  /** @returns {boolean} whether what is seen is coarser than it will be at rest */
  get coarse() {
    return this.sentShare < 0.95 * shareFor(this.resting, this.whole);
  }

  /** A picture was sent off, of so much of the pixels along a side. */
  sent(share) {
    this.forget();
    Object.assign(this, { sentShare: share, sentAt: performance.now() });
    this.sync = this.gl.fenceSync(this.gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    this.gl.flush();
    this.poll();
  }

  /** @returns {boolean} whether the last picture is still being drawn */
  busy() {
    const { gl, sync } = this;
    if (!sync) return false;
    const late = performance.now() - this.sentAt;
    if (gl.clientWaitSync(sync, 0, 0) === gl.TIMEOUT_EXPIRED && late < LONGEST) return true;
    this.forget();
    // The first picture waits for its shader: that says nothing of those to come. The second ends the guess.
    const found = Math.max(1, late / this.sentShare ** 2);
    if (this.pictures > 0) this.whole = this.pictures > 1 ? (this.whole + found) / 2 : found;
    this.pictures += 1;
    if (!this.moving && this.coarse) this.rested();
    return false;
  }

  // Asked for until it is there, and no longer: how long it took would else be told when somebody comes back.
  poll() {
    this.timers.poll = setTimeout(() => {
      if (this.busy()) this.poll();
    }, POLL);
  }

  forget() {
    clearTimeout(this.timers.poll);
    if (this.sync) this.gl.deleteSync(this.sync);
    this.sync = null;
  }

  stop() {
    clearTimeout(this.timers.rest);
    clearTimeout(this.timers.settled);
    this.forget();
  }
}
