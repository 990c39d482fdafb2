// The place of an AR session in a map: its poses are smooth but begin anywhere, answers are rare but of the map.

import { Axes, angleBetween, carried, inverse, meanRotation, multiply, toOpenCV } from "./poses.js";

const KEPT = 12; // samples
const DRIFT_M = 0.05; // by which a session may have drifted between two samples that agree
const DRIFT_RAD = 0.04;
const DRIFT_SHARE = 0.02; // of the way from where a sample was taken
const SIGMAS = 3;
const CONTRADICTIONS = 3; // in a row, after which a place is given up

/**
 * Where a session of ARKit, ARCore or WebXR lies in a map: `T_map_session`, a robust mean over answers.
 *
 *     const session = new MapSession((image, options) => rholoc.localize("hall", image, options), {
 *       onLocalized: (T_map_session) => scene.place(T_map_session),
 *     });
 *     // for every frame, the pose and the picture of the same moment:
 *     session.offer({ pose: view.transform.matrix, picture: () => jpegOf(frame), camera });
 */
export class MapSession {
  /**
   * @param {(image: any, options: import("./types/api.d.ts").LocalizeOptions) =>
   *   Promise<import("./types/api.d.ts").LocalizationOut>} locate answers a picture, as {@link Client.localize} does
   * @param {object} [options]
   * @param {string} [options.axes] of {@link Axes}: how the session's poses are laid
   * @param {number} [options.minRecognized] the probability of the right place from which one answer is enough; below, two that
   *   agree
   * @param {number} [options.intervalMs] between questions once the place is known; a third of it before
   * @param {number} [options.lostAfterMs] without an answer that agrees
   * @param {(T_map_session: number[][]) => void} [options.onLocalized] the place is known, or known better
   * @param {() => void} [options.onLost] it is not known any more
   * @param {(error: Error) => void} [options.onError] a question failed; the next is asked as planned
   * @param {() => number} [options.now] milliseconds on any clock
   */
  constructor(
    locate,
    {
      axes = Axes.OPENGL,
      minRecognized = 0.8,
      intervalMs = 1500,
      lostAfterMs = 20_000,
      onLocalized = () => {},
      onLost = () => {},
      onError = () => {},
      now = () => performance.now(),
    } = {},
  ) {
    /** @type {string} */
    this.axes = axes;
    this.minRecognized = minRecognized;
    this.intervalMs = intervalMs;
    this.lostAfterMs = lostAfterMs;
    /** @type {(T_map_session: number[][]) => void} */
    this.onLocalized = onLocalized;
    this.onLost = onLost;
    /** @type {(error: Error) => void} */
    this.onError = onError;
    this._locate = locate;
    this._now = now;
    this._samples = [];
    this._asking = false;
    this._askedMs = -Infinity;
    this._agreedMs = -Infinity;
    this._contradicted = 0;
    /**
     * The session's place (4 × 4, right-handed); null while it is not known.
     * @type {number[][] | null}
     */
    this.T_map_session = null;
  }

  /**
   * Offer a frame; it is asked about if that pays. Resolves once it has been answered, to whether it was asked about.
   * @param {object} frame
   * @param {number[][] | ArrayLike<number>} frame.pose of the camera in the session, when the picture was taken
   * @param {any} frame.picture the picture, or a function that makes it, called only where it is asked about
   * @param {import("./types/api.d.ts").CameraChoice} frame.camera its intrinsics: fx, fy, cx, cy, width, height
   * @throws {RangeError} the pose is no rigid motion
   */
  async offer({ pose, picture, camera }) {
    const T_session_camera = toOpenCV(pose, this.axes);
    this._lapse();
    const pause = this.T_map_session === null ? this.intervalMs / 3 : this.intervalMs;
    if (this._asking || this._now() - this._askedMs < pause) return false;
    this._asking = true;
    this._askedMs = this._now();
    try {
      const image = typeof picture === "function" ? await picture() : picture;
      const answer = await this._locate(image, { camera });
      if (answer.localized && answer.covariance) this._take(answer, T_session_camera);
    } catch (error) {
      this.onError(error);
    } finally {
      this._asking = false;
    }
    return true;
  }

  /**
   * A pose of the session, by its own axes → T_map_camera; null while the place is not known.
   * @param {number[][] | ArrayLike<number>} pose
   * @returns {number[][] | null}
   */
  inMap(pose) {
    return this.T_map_session && multiply(this.T_map_session, toOpenCV(pose, this.axes));
  }

  /**
   * A point of the map → of the session, by its own axes; null while the place is not known.
   * @param {number[]} point
   * @returns {number[] | null}
   */
  toSession(point) {
    if (this.T_map_session === null) return null;
    const [x, y, z] = carried(inverse(this.T_map_session), point);
    return this.axes === Axes.UNITY ? [x, y, -z] : [x, y, z];
  }

  _take(answer, T_session_camera) {
    const variances = [0, 1, 2, 3, 4, 5].map((i) => answer.covariance[i][i]);
    const sample = {
      T: multiply(answer.pose.T_map_camera, inverse(T_session_camera)),
      at: T_session_camera.slice(0, 3).map((row) => row[3]),
      sigmaM: Math.max(0.005, Math.sqrt(Math.max(...variances.slice(0, 3)))),
      sigmaRad: Math.max(0.003, (Math.PI / 180) * Math.sqrt(Math.max(...variances.slice(3)))),
      recognized: answer.recognized,
    };
    this._samples = [...this._samples, sample].slice(-KEPT);
    const group = this._samples.filter((one) => agree(one, sample));
    const before = this.T_map_session;
    const expected = before === null || agree({ ...sample, T: before }, sample);
    const enough = group.length >= 2 || sample.recognized >= this.minRecognized;
    if (!expected && ++this._contradicted < CONTRADICTIONS) return;
    if (!enough) return;
    if (!expected) this._samples = group;
    this._contradicted = 0;
    this._agreedMs = this._now();
    this.T_map_session = mean(group, sample.at);
    this.onLocalized(this.T_map_session);
  }

  _lapse() {
    if (this.T_map_session === null || this._now() - this._agreedMs <= this.lostAfterMs) return;
    this.T_map_session = null;
    this._samples = [];
    this.onLost();
  }
}

/** Whether two samples place the second one's camera alike. */
function agree(a, b) {
  const sigmaM = Math.hypot(a.sigmaM, b.sigmaM);
  const [there, here] = [carried(a.T, b.at), carried(b.T, b.at)];
  const apart = Math.hypot(...there.map((value, i) => value - here[i]));
  const turn = angleBetween(a.T, b.T);
  return apart < DRIFT_M + SIGMAS * sigmaM && turn < DRIFT_RAD + SIGMAS * Math.hypot(a.sigmaRad, b.sigmaRad);
}

/** The mean of samples, which is most exact around a point of the session; the nearer one was taken, the more it counts. */
function mean(samples, at) {
  const precisions = samples.map(({ sigmaM, at: taken }) => {
    const drift = DRIFT_SHARE * Math.hypot(...taken.map((value, i) => value - at[i]));
    return 1 / (sigmaM ** 2 + drift ** 2);
  });
  const total = precisions.reduce((sum, one) => sum + one, 0);
  const R = meanRotation(
    samples.map(({ T }) => T),
    samples.map(({ sigmaRad }) => sigmaRad ** -2),
  );
  const there = [0, 1, 2].map((i) =>
    samples.reduce((sum, { T }, k) => sum + (precisions[k] / total) * carried(T, at)[i], 0),
  );
  const t = there.map((value, i) => value - R[i].reduce((sum, one, j) => sum + one * at[j], 0));
  return [...R.map((row, i) => [...row, t[i]]), [0, 0, 0, 1]];
}
