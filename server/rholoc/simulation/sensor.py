"""Model of a phone's camera: exposure, white balance, noise, gamma."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from rholoc.geometry import ByteArray, FloatArray
from rholoc.simulation.light import GAMMA

LONGEST_EXPOSURE_S = 0.010  # one flicker period of lamps on 50 Hz mains
_SHORTEST_EXPOSURE_S = 0.0005
_MEAN_LEVEL = 0.5  # of the encoded picture, what the exposure aims at
_WHITE_BALANCE = 0.7  # 1 would turn every picture grey on average
_ELECTRONS_PER_CD_S = 1600.0  # caught by a pixel per cd/m² and second
_READ_NOISE_ELECTRONS = 4.0
_BASE_GAIN_LUMINANCE_S = 1.0  # cd/m² · s that saturate the sensor without gain
_POOL_MARGIN_PX = 160


@dataclass(frozen=True, eq=False)
class Exposure:
    """The camera's settings for one frame.

    Attributes:
        seconds: how long the shutter is open.
        gains: (3,) BGR, from luminance relative to ``white_luminance`` to the linear picture, 1 saturates.
        white_luminance: cd/m².
    """

    seconds: float
    gains: FloatArray
    white_luminance: float


def meter(picture: ByteArray) -> FloatArray:
    """Linear gains (3,) BGR that expose ``picture`` (H, W, 3), encoded luminance, to a mean of 0.5, nearly balanced."""
    linear = (picture.reshape(-1, 3) / 255.0) ** GAMMA
    means = np.maximum(linear.mean(axis=0), 1e-4)
    balance = (means[1] / means) ** _WHITE_BALANCE
    gain = 0.2 / means[1]
    for _ in range(4):
        level = (np.clip(gain * balance * linear, 0, 1) ** (1 / GAMMA)).mean()
        gain *= (_MEAN_LEVEL / max(float(level), 1e-3)) ** GAMMA
    return np.asarray(np.clip(gain, 0.05, 60.0) * balance)


def expose(gains: FloatArray, white_luminance: float) -> Exposure:
    """Exposure with linear gains (3,) BGR relative to ``white_luminance`` [cd/m²]: a shutter of 0.5 to 10 ms, then
    amplification.
    """
    saturating = white_luminance / float(gains[1])  # cd/m²
    seconds = float(np.clip(_BASE_GAIN_LUMINANCE_S / saturating, _SHORTEST_EXPOSURE_S, LONGEST_EXPOSURE_S))
    return Exposure(seconds, gains, white_luminance)


def develop(picture: ByteArray, exposure: Exposure, rng: np.random.Generator) -> ByteArray:
    """Image (H, W, 3) BGR by the camera of a ``picture`` (H, W, 3) of encoded luminance: amplified, noisy, encoded."""
    levels = np.arange(256, dtype=np.float64)[:, None] / 255.0
    linear = levels**GAMMA
    electrons = linear * exposure.white_luminance * exposure.seconds * _ELECTRONS_PER_CD_S
    per_electron = exposure.gains / (exposure.white_luminance * exposure.seconds * _ELECTRONS_PER_CD_S)
    deviation = per_electron * np.sqrt(electrons + _READ_NOISE_ELECTRONS**2)  # (256, 3), linear
    amplified = exposure.gains * linear
    signal = 255 * amplified ** (1 / GAMMA)
    signal[255] = np.maximum(signal[255], 255)  # whatever is as bright as this, or brighter, is saturated
    # The curve's secant, not its tangent: near black the tangent is infinitely steep.
    encoded = 0.5 * 255 * ((amplified + deviation) ** (1 / GAMMA) - np.maximum(amplified - deviation, 0) ** (1 / GAMMA))
    clean = cv2.LUT(picture, signal.astype(np.float32)[None])
    spread = cv2.LUT(picture, encoded.astype(np.float32)[None])
    noisy = clean + spread * _noise(rng, *picture.shape[:2])
    return np.asarray(cv2.convertScaleAbs(np.clip(noisy, 0, 255)))


def _noise(rng: np.random.Generator, height: int, width: int) -> FloatArray:
    """Noise (H, W, 3) of about unit variance: a random cut from a pool that is drawn once, for speed."""
    y, x = rng.integers(0, _POOL_MARGIN_PX, 2)
    cut = _noise_pool(height, width)[y : y + height, x : x + width]
    return cut[:: -1 if rng.uniform() < 0.5 else 1, :: -1 if rng.uniform() < 0.5 else 1]


@lru_cache(maxsize=2)
def _noise_pool(height: int, width: int) -> FloatArray:
    """Noise (H + 160, W + 160, 3), always the same, correlated between neighbours, in colour more than brightness."""
    rng = np.random.default_rng(0)
    shape = (height + _POOL_MARGIN_PX, width + _POOL_MARGIN_PX)
    common = cv2.GaussianBlur(rng.standard_normal((*shape, 1), dtype=np.float32), (0, 0), 0.5)
    colored = cv2.GaussianBlur(rng.standard_normal((*shape, 3), dtype=np.float32), (0, 0), 1.0)
    pool = 0.75 * common[..., None] / common.std() + 0.66 * colored / colored.std()
    return np.asarray(pool, dtype=np.float32)
