"""A phone that walks: its camera shows a simulated walk, and its motion sensors feel it, both by the page's clock.

Chromium's own fake camera shows picture after picture, and one that comes late delays all that follow: on a busy
machine film and sensors drift apart. This camera chooses each picture by the moment at which it hands it over, and
leaves out what would come late, as a camera does; the sensors' readings carry the times at which they were taken.
"""

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from playwright.sync_api import Page

from rholoc.geometry import ByteArray
from rholoc.recordings import Imu

_JPEG_QUALITY = 95

_PHONE = """({jpegs, fps, readings, length, lateMs, standMs}) => {
    const count = jpegs.length;
    let [begun, heard] = [Infinity, 0];  // when the walk began, ms; how many readings were given
    const taken = [];  // when pictures were, ms
    const walked = () => Math.max(0, (performance.now() - begun) / 1000);

    navigator.mediaDevices.getUserMedia = async () => {
        const bytes = (jpeg) => Uint8Array.from(atob(jpeg), (letter) => letter.charCodeAt(0));
        const pictures = await Promise.all(jpegs.map((jpeg) => createImageBitmap(new Blob([bytes(jpeg)]))));
        const track = new MediaStreamTrackGenerator({kind: "video"});
        const settings = track.getSettings.bind(track);
        track.getSettings = () => ({...settings(), facingMode: "environment"});
        const writer = track.writable.getWriter();
        let shown = -1;
        setInterval(() => {
            const [now, time] = [performance.now(), walked()];
            const picture = Math.min(count - 1, Math.floor(time * fps));
            const isDue = picture !== shown && 1000 * (time - picture / fps) < lateMs;
            const stands = (time === 0 || picture === count - 1) && now - (taken.at(-1) ?? 0) > 1000 / fps;
            if (!isDue && !stands) return;
            shown = picture;
            taken.push(now);
            writer.write(new VideoFrame(pictures[picture], {timestamp: Math.round(1000 * now)}));
        }, 4);
        return new MediaStream([track]);
    };
    const watch = HTMLVideoElement.prototype.requestVideoFrameCallback;
    HTMLVideoElement.prototype.requestVideoFrameCallback = function (hear) {
        return watch.call(this, (now, metadata) => {
            const captureTime = taken.findLast((at) => at <= metadata.presentationTime);
            hear(now, {...metadata, captureTime});
        });
    };

    const feel = ([time, x, y, z, alpha, beta, gamma]) => {
        const reading = new DeviceMotionEvent("devicemotion", {interval: 10,
            accelerationIncludingGravity: {x, y, z}, rotationRate: {alpha, beta, gamma}});
        if (time !== null) Object.defineProperty(reading, "timeStamp", {value: begun + 1000 * time});
        dispatchEvent(reading);
    };
    setInterval(() => {
        if (begun === Infinity) feel([null, ...readings[0].slice(1)]);
        while (heard < readings.length && readings[heard][0] <= walked()) feel(readings[heard++]);
    }, 10);

    // Walk to the end, and stand there for a moment.
    window.walk = () => {
        [begun, heard] = [performance.now(), 0];
        return new Promise((resolve) => setTimeout(resolve, 1000 * length + standMs));
    };

    // Record the walk from its beginning to its end and mark points at these moments of it; when they really were.
    window.recordTheWalk = (moments) => new Promise((resolve) => {
        const marked = [];
        begun = performance.now();
        document.querySelector("button.shutter").click();
        const watching = setInterval(() => {
            if (walked() >= moments[marked.length]) {
                marked.push(walked());
                document.querySelector("button.waypoint").click();
            }
            if (walked() < length || marked.length < moments.length) return;
            clearInterval(watching);
            document.querySelector("button.shutter").click();
            resolve(marked);
        }, 2);
    });
}"""
_LATE_MS = 20  # within which a picture is handed over, or left out
_STAND_MS = 2000  # for what is shown to arrive where the walk ends


@dataclass(frozen=True, eq=False)
class WalkingPhone:
    """What a phone sees and feels on a walk that begins at 0 s.

    Attributes:
        pictures: (H, W, 3) BGR, ``fps`` a second.
        imu: in the device's axes, gravity included.
    """

    pictures: Sequence[ByteArray]
    fps: float
    imu: Imu

    def becomes(self, page: Page) -> None:
        """Let a page that is not open yet have this phone's camera and sensors."""
        readings = np.column_stack(
            [self.imu.times, self.imu.acceleration, np.degrees(self.imu.angular_velocity)]
        ).round(6)
        length_s = len(self.pictures) / self.fps
        phone = {
            "jpegs": [_jpeg(picture) for picture in self.pictures],
            "fps": self.fps,
            "readings": readings[readings[:, 0] <= length_s].tolist(),
            "length": length_s,
            "lateMs": _LATE_MS,
            "standMs": _STAND_MS,
        }
        page.add_init_script(f"({_PHONE})({json.dumps(phone)})")

    def walk(self, page: Page) -> None:
        """Walk before a page that has the camera open already; returns a moment after the end."""
        page.evaluate("walk")

    def record(self, page: Page, moments: Sequence[float]) -> list[float]:
        """Record the walk with the page's recorder, which has its camera open; mark points at seconds of the walk.

        Returns:
            The seconds at which they were marked.
        """
        return page.evaluate("recordTheWalk", list(moments))


def _jpeg(picture: ByteArray) -> str:
    """As base64."""
    jpeg = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1]
    return base64.b64encode(jpeg.tobytes()).decode()
