// The camera: opened, watched frame by frame, measured for light.

import { t } from "../shared/text.js";
import { brightness, greyLevels, sharpness, texture } from "./coaching.js";
import { Problem } from "./problem.js";

const REFUSALS = {
  NotAllowedError: [
    "camera-refused",
    t`The camera was refused.`,
    t`Allow it for this page in the browser's settings, then try again.`,
  ],
  NotFoundError: ["no-camera", t`There is no camera.`, t`Open this page on a phone.`],
  NotReadableError: ["camera-busy", t`Another program has the camera.`, t`Close it and try again.`],
};
// The first that the browser can write; hardware encodes H.264, and WebM survives being cut off.
const TYPES = [
  "video/webm;codecs=h264",
  "video/mp4;codecs=avc1.42E01E",
  "video/webm;codecs=vp8",
  "video/webm",
  "video/mp4",
];
const METER_LONG_SIDE = 160; // px, of the small picture that is measured

/** The stream of the camera on the back, in a size if it has that. @throws {Problem} */
export async function openCamera(width = 1280, height = 720) {
  const [size, frameRate] = [{ width: { ideal: width }, height: { ideal: height } }, { ideal: 30 }];
  try {
    return await navigator.mediaDevices.getUserMedia({
      audio: false,
      video: { facingMode: { ideal: "environment" }, ...size, frameRate },
    });
  } catch (error) {
    throw new Problem(...(REFUSALS[error.name] ?? ["camera-failed", t`The camera does not start.`, error.message]));
  }
}

/** The format that MediaRecorder writes here. */
export function videoType() {
  return TYPES.find((type) => MediaRecorder.isTypeSupported(type)) ?? "";
}

/** The file name of a video of a MIME type. */
export function videoName(type) {
  const suffix = type.startsWith("video/mp4") ? "mp4" : type.startsWith("video/x-matroska") ? "mkv" : "webm";
  return `video.${suffix}`;
}

/** Whether a stream comes from the camera on the back, as far as the browser says. */
export function facesAway(stream) {
  return stream.getVideoTracks()[0].getSettings().facingMode === "environment";
}

/**
 * Hear when each frame that a video element shows was taken, in seconds on the clock of performance.now().
 * Returns a function that ends it. A browser without requestVideoFrameCallback says nothing.
 */
export function watchFrames(video, hear) {
  if (!video.requestVideoFrameCallback) return () => {};
  let handle = 0;
  const next = () => {
    handle = video.requestVideoFrameCallback((now, { captureTime }) => {
      hear((captureTime ?? now) / 1000);
      next();
    });
  };
  next();
  return () => video.cancelVideoFrameCallback(handle);
}

/** A function that measures a video element's picture: `{light, texture, sharpness}`; all null before it has one. */
export function pictureMeter(video) {
  const canvas = document.createElement("canvas");
  const context = canvas.getContext("2d", { willReadFrequently: true });
  return () => {
    const { videoWidth, videoHeight } = video;
    if (!videoWidth) return { light: null, texture: null, sharpness: null };
    const scale = METER_LONG_SIDE / Math.max(videoWidth, videoHeight);
    const [width, height] = [videoWidth, videoHeight].map((size) => Math.round(scale * size));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    context.drawImage(video, 0, 0, width, height);
    const grey = greyLevels(context.getImageData(0, 0, width, height).data);
    return {
      light: brightness(grey),
      texture: texture(grey, width, height),
      sharpness: sharpness(grey, width, height),
    };
  };
}
