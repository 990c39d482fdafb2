"""``rholoc recording flow``: what moves by known pixels is found to."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from rholoc.cli import main
from rholoc.pictures.flow import dense_png
from rholoc.trajectory.visual.dense_flow import DenseMethod, dense_flow


def _texture() -> np.ndarray:
    rng = np.random.default_rng(4)
    layers = [cv2.resize(rng.random((30 * k, 40 * k)), (420, 320), interpolation=cv2.INTER_CUBIC) for k in (1, 2, 4)]
    return np.uint8(np.clip(255 * np.mean(layers, axis=0), 0, 255))


@pytest.mark.parametrize("method", list(DenseMethod))
def test_a_shift_is_found_everywhere(method: DenseMethod) -> None:
    wide = _texture()
    flow = dense_flow(wide[20:260, 20:340], wide[18:258, 15:335], method)  # the picture moves by (5, 2)
    inner = flow[30:-30, 30:-30]
    assert np.allclose(np.median(inner, axis=(0, 1)), (5, 2), atol=0.2)


def test_red_is_to_the_right() -> None:
    flow = np.zeros((8, 8, 2))
    flow[:, :, 0] = 3.0
    picture = cv2.imdecode(np.frombuffer(dense_png(flow), np.uint8), cv2.IMREAD_COLOR)
    assert picture[4, 4].tolist() == [0, 0, 255]


def test_tracks_and_fields_are_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    wide, folder, out = _texture(), tmp_path / "walk", tmp_path / "flow"
    folder.mkdir()
    for frame in range(6):
        cv2.imwrite(str(folder / f"frame-{frame:06d}.png"), wide[20:260, 60 - 4 * frame : 380 - 4 * frame])
    arguments = ["rholoc", "recording", "flow", folder, "-o", out, "--pictures", "2", "--json"]
    monkeypatch.setattr(sys, "argv", [str(one) for one in arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    assert not ended.value.code
    figures = json.loads(capsys.readouterr().out)
    assert figures["frames"] == 6
    assert figures["motion_a_frame_px"] == pytest.approx(4, abs=0.5)
    assert figures["dense_off_tracks_px"] < 0.5
    table = np.loadtxt(out / "tracks.csv", delimiter=",", skiprows=1)
    longest = table[table[:, 1] == np.bincount(table[:, 1].astype(int)).argmax()]
    assert np.allclose(np.diff(longest[:, 2]), 4, atol=0.5)
    assert {path.name.partition("-")[0] for path in out.glob("*.png")} == {"tracks", "dense"}
    assert len(list(out.glob("*.png"))) == 4
