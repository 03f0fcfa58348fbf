// How finely to draw while something moves: as finely as the graphics processor keeps up with, in full at rest.

const SLOW = 45; // milliseconds of a picture above which the next one has fewer pixels
const QUICK = 16;
const LEAST = 0.25;
const REST = 220; // milliseconds without a change until the full picture is drawn

/** Watches how long pictures take. */
export class Pace {
  /** @param {WebGL2RenderingContext} gl @param {() => void} rested called when a full picture is due */
  constructor(gl, rested) {
    this.gl = gl;
    this.rested = rested;
    this.scale = 0.6;
    this.moving = false;
    this.sync = null;
    this.timer = 0;
    this.coarse = true; // whether what is seen has fewer pixels than the screen
  }

  /** Something changed: coarse pictures will do until it rests. */
  stir() {
    this.moving = true;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => {
      this.moving = false;
      if (this.coarse) this.rested();
    }, REST);
  }

  /** @returns {number} the factor on the pixels' number along a side of the next picture */
  share() {
    return this.moving ? this.scale : 1;
  }

  /** A picture was sent off, of so much of the pixels along a side. */
  sent(share) {
    this.coarse = share < 1;
    this.sentShare = share;
    this.sentAt = performance.now();
    if (this.sync) this.gl.deleteSync(this.sync);
    this.sync = this.gl.fenceSync(this.gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    this.gl.flush();
  }

  /** @returns {boolean} whether the last picture is still being drawn; once it is not, the scale follows its time */
  busy() {
    const { gl, sync } = this;
    if (!sync) return false;
    const late = performance.now() - this.sentAt;
    if (gl.clientWaitSync(sync, 0, 0) === gl.TIMEOUT_EXPIRED && late < 5000) return true;
    gl.deleteSync(sync);
    this.sync = null;
    if (this.sentShare === this.scale || late > SLOW) {
      if (late > SLOW) this.scale = Math.max(LEAST, Math.min(this.scale, this.sentShare) * Math.max(0.5, Math.sqrt(SLOW / late)));
      else if (late < 2 * QUICK) this.scale = Math.min(1, this.scale * 1.15);
    }
    return false;
  }

  stop() {
    clearTimeout(this.timer);
    if (this.sync) this.gl.deleteSync(this.sync);
    this.sync = null;
  }
}
