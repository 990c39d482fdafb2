// Written by client/js/write_types.py: run `make format`.
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
     * @param {(image: any, options: import("./api.d.ts").LocalizeOptions) =>
     *   Promise<import("./api.d.ts").LocalizationOut>} locate answers a picture, as {@link Client.localize} does
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
    constructor(locate: (image: any, options: import("./api.d.ts").LocalizeOptions) => Promise<import("./api.d.ts").LocalizationOut>, { axes, minRecognized, intervalMs, lostAfterMs, onLocalized, onLost, onError, now, }?: {
        axes?: string;
        minRecognized?: number;
        intervalMs?: number;
        lostAfterMs?: number;
        onLocalized?: (T_map_session: number[][]) => void;
        onLost?: () => void;
        onError?: (error: Error) => void;
        now?: () => number;
    });
    /** @type {string} */
    axes: string;
    minRecognized: number;
    intervalMs: number;
    lostAfterMs: number;
    /** @type {(T_map_session: number[][]) => void} */
    onLocalized: (T_map_session: number[][]) => void;
    onLost: () => void;
    /** @type {(error: Error) => void} */
    onError: (error: Error) => void;
    _locate: (image: any, options: import("./api.d.ts").LocalizeOptions) => Promise<import("./api.d.ts").LocalizationOut>;
    _now: () => number;
    _samples: any[];
    _asking: boolean;
    _askedMs: number;
    _agreedMs: number;
    _contradicted: number;
    /**
     * The session's place (4 × 4, right-handed); null while it is not known.
     * @type {number[][] | null}
     */
    T_map_session: number[][] | null;
    /**
     * Offer a frame; it is asked about if that pays. Resolves once it has been answered, to whether it was asked about.
     * @param {number[][] | ArrayLike<number>} frame.pose of the camera in the session, when the picture was taken
     * @param {any} frame.picture the picture, or a function that makes it, called only where it is asked about
     * @param {import("./api.d.ts").CameraChoice} frame.camera its intrinsics: fx, fy, cx, cy, width, height
     * @throws {RangeError} the pose is no rigid motion
     */
    offer({ pose, picture, camera }: {
        pose: number[][] | ArrayLike<number>;
        picture: any;
        camera: import("./api.d.ts").CameraChoice;
    }): Promise<boolean>;
    /** A pose of the session, by its own axes → T_map_camera; null while the place is not known. */
    inMap(pose: number[][] | ArrayLike<number>): number[][] | null;
    /** A point of the map → of the session, by its own axes; null while the place is not known. */
    toSession(point: number[]): number[] | null;
    _take(answer: any, T_session_camera: any): void;
    _lapse(): void;
}
