"""Fit and check the confidence of answers (rholoc.localization.belief.confidence), by recordings that are held back.

    python benchmarks/calibrate_confidence.py --cache FOLDER [--features gray,lab,lab3,rgb,sift,sift48] [--minutes 10]
        [--room "kitchen, hard" ...] [--fit redkitchen ...]

Every kind of features in every room of benchmarks/rooms.py. What is asked of a room's map: frames of the room, whole
and with an eighth of their features (frames that are easy say nothing about doubt); and pictures of all other rooms,
which are all wrong; of what is asked from a walk's other end, whole frames alone. To these confidence is fitted, to all
recordings or to those named by ``--fit``. Besides, frames as if by a camera whose focal length is a tenth off, to which
exactness alone is fitted, too; and, to check, windows of a frame, over a seventh of its area, in a picture of another
room: a thing that looks alike.

Answers are kept in the cache, room by room, until the code that gives them changes; after ``--minutes`` of processor
time the command ends and says what is missing, and asking again goes on there. With all at hand it prints, of each
kind of features, by weights fitted to all kinds together and to all recordings but the one that is asked
about, for several thresholds and each recording how many pictures of other rooms are refused, how many good answers are
kept, and how many of the answers given are wrong; whole frames and those with an eighth of their features apart. In the
end it prints, side by side, these figures, those of the weights in use, and how reliable these are. Simulated rooms are
built alike: other ones are the hardest pictures of other rooms.
"""

import argparse
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import minimize
from scipy.special import log_expit

from asking import Answered, Case, Kind, answers_of
from measuring import print_table
from rholoc.features import extractor_names
from rholoc.geometry import BoolArray, FloatArray
from rholoc.localization.belief.confidence import MIN_RECOGNIZED, WEIGHTS, Weights
from rooms import ROOMS, WIDE, NamedRoom

ONLY_CHECKED = (Kind.FOCAL_OFF, Kind.WINDOW)  # by the reliability; exactness is fitted to wrong cameras, too
LESS_EXACT = ("xfeat",)  # than their sigma says: fitted apart
RIDGE = 0.7
LEAST_SLOPE = 0.05  # of a standardized input: each has a say
BINS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.1)  # of confidence
THRESHOLDS = (0.3, 0.4, 0.5, 0.6, 0.7)
OUT_OF_TIME = 3


def all_answered(
    features: list[str], rooms: list[NamedRoom], kept: Path, is_late: Callable[[], bool]
) -> tuple[list[Answered], int]:
    """What is kept or can be asked in time, and how much is missing then."""
    found = [answers_of(named, name, kept, is_late, named in WIDE) for name in features for named in rooms]
    return [one for one in found if one is not None], found.count(None)


# -- fitting and checking --------------------------------------------------------------------------------------------


def fit(answered: list[Answered]) -> Weights:
    """The likeliest weights of being at the right place and of being exact there, the same for all extractors.

    Wrong cameras count for the latter: a focal length that is off displaces a pose within the right place.
    """
    named = [(one.features, case, case.features) for one in answered for case in one.cases if case.features]
    cases = [case for _, case, _ in named if case.kind not in ONLY_CHECKED]
    features = [of for _, case, of in named if case.kind not in ONLY_CHECKED]
    at_place = np.array([case.is_right_place for case in cases], dtype=bool)
    place = np.array([one.place for one in features]).reshape(-1, 3)
    extras = np.array([[one.patches, one.colours] for one in features]).reshape(-1, 2)
    factor = np.clip([case.factor for case in cases], 1e-6, 1.0)

    def by(*columns: int) -> tuple[float, ...]:
        """By the place and some of what is not always known, to the answers where it is."""
        told = np.isfinite(extras[:, columns]).all(axis=1)
        inputs = np.column_stack([place, extras[:, columns]])[told]
        return logistic(inputs, at_place[told], factor[told], (1,) * inputs.shape[1])

    here = [(case, of) for name, case, of in named if case.is_right_place and name not in LESS_EXACT]
    sigma = np.array([[of.sigma] for _, of in here]).reshape(-1, 1)
    exact_factor = np.clip([case.exact_factor for case, _ in here], 1e-6, 1.0)
    exact = logistic(sigma, np.array([case.right for case, _ in here], dtype=bool), exact_factor, (-1,))
    return Weights(place=by(), colours=by(1), patches=by(0), both=by(0, 1), exact=exact)


def logistic(inputs: FloatArray, true: BoolArray, factor: FloatArray, signs: tuple[int, ...]) -> tuple[float, ...]:
    """Intercept and slopes of a logistic in inputs (N, D), with a little ridge on what standardized ones weigh.

    Args:
        factor: (N,) what else the probability is multiplied by; what lowers it so need not be said twice.
        signs: which way each input may speak: 1 for, -1 against.
    """
    if not len(inputs):
        return (0.0,) * (len(signs) + 1)
    mean, spread = inputs.mean(axis=0), inputs.std(axis=0) + 1e-9
    X = np.column_stack([np.ones(len(inputs)), (inputs - mean) / spread])
    with np.errstate(divide="ignore"):
        without = np.log1p(-factor)

    def loss(w: FloatArray) -> float:
        false = np.logaddexp(without, np.log(factor) + log_expit(-(X @ w)))
        return float(RIDGE * (w[1:] @ w[1:]) - np.where(true, log_expit(X @ w), false).sum())

    bounds = [(None, None), *((LEAST_SLOPE, None) if one > 0 else (None, -LEAST_SLOPE) for one in signs)]
    found = minimize(loss, np.zeros(X.shape[1]), bounds=bounds)
    slopes = found.x[1:] / spread
    return (float(found.x[0] - slopes @ mean), *slopes.tolist())


def beliefs_by(weights: Weights, cases: list[Case]) -> tuple[FloatArray, FloatArray]:
    """Each case's ``recognized`` (N,) and ``confidence`` (N,)."""
    beliefs = [case.belief(weights) for case in cases]
    return np.array([one.recognized for one in beliefs]), np.array([one.confidence for one in beliefs])


@dataclass(frozen=True)
class Judged:
    """Answers, their ``recognized`` (N,) and ``confidence`` (N,) by some weights."""

    features: str
    recording: str
    room: str
    cases: list[Case]
    recognized: FloatArray
    confidence: FloatArray


def weights_without(recordings: Iterable[str], fitted: list[Answered]) -> dict[str, Weights]:
    """Weights by recording: fitted to the answers of the others."""
    return {name: fit([one for one in fitted if one.recording != name]) for name in dict.fromkeys(recordings)}


def judge(answered: Answered, weights: Weights = WEIGHTS) -> Judged:
    """A room's answers by some weights."""
    one = answered
    return Judged(one.features, one.recording, one.room, one.cases, *beliefs_by(weights, one.cases))


def of(judged: list[Judged], chosen: Callable[[Case], bool], exact: bool = False) -> tuple[FloatArray, BoolArray]:
    """``recognized`` (N,) of chosen cases and whether their place is right (N,).

    Or, if ``exact``, ``confidence`` and whether they are within 10 cm and 5°.
    """
    pairs = [
        (said, case.right if exact else case.is_right_place)
        for one in judged
        for case, said in zip(one.cases, one.confidence if exact else one.recognized, strict=True)
        if chosen(case)
    ]
    said, right = zip(*pairs, strict=True) if pairs else ((), ())
    return np.array(said), np.array(right, dtype=bool)


@dataclass(frozen=True)
class Bin:
    """Answers of about the same probability: how many, its mean, the share that is right."""

    name: str
    answers: int
    says: float
    right: float


def reliability(judged: list[Judged], exact: bool) -> list[Bin]:
    """The answers of about the same ``recognized``, or ``confidence`` if ``exact``, where there are some."""
    confidence, right = of(judged, lambda case: case.kind not in ONLY_CHECKED, exact)
    bins = []
    for low, high in pairwise(BINS):
        inside = (confidence >= low) & (confidence < high)
        if inside.any():
            name = f"{low:.1f}–{min(high, 1):.1f}"
            bins.append(Bin(name, int(inside.sum()), float(confidence[inside].mean()), float(right[inside].mean())))
    return bins


def reliability_table(judged: list[Judged], exact: bool) -> list[dict[str, str]]:
    """A row for each bin of probability, a column a kind of features: the share that is right, and of how many."""
    said = "confidence" if exact else "recognized"
    rows = {one.name: {said: one.name, "says": f"{one.says:.2f}"} for one in reliability(judged, exact)}
    for name in dict.fromkeys(one.features for one in judged):
        for one in reliability([some for some in judged if some.features == name], exact):
            rows[one.name][name] = f"{one.right:.2f} of {one.answers}"
    return list(rows.values())


def figures(judged: list[Judged], threshold: float) -> dict[str, str]:
    """What refusing below a threshold comes to."""

    def share(chosen: Callable[[Case], bool], given: bool = True) -> str:
        said, _ = of(judged, chosen)
        passed = (said >= threshold) == given
        return f"{100 * passed.mean():.1f} % of {len(said)}" if len(said) else "–"

    def wrong(kind: Kind) -> str:
        said, right = of(judged, lambda case: case.kind is kind)
        given = said >= threshold
        return f"{int((given & ~right).sum())} of {int(given.sum())}"

    return {
        "other rooms refused": share(lambda case: case.kind is Kind.OTHER_ROOM, given=False),
        "right places kept": share(lambda case: case.kind is Kind.WHOLE and case.is_right_place),
        "good answers kept": share(lambda case: case.kind is Kind.WHOLE and case.right),
        "wrong of given": wrong(Kind.WHOLE),
        "an eighth: kept": share(lambda case: case.kind is Kind.FEWER and case.right),
        "an eighth: wrong": wrong(Kind.FEWER),
        "focal 1.1: wrong": wrong(Kind.FOCAL_OFF),
        "windows given": share(lambda case: case.kind is Kind.WINDOW),
    }


def log_score(judged: list[Judged]) -> float:
    """The mean logarithmic loss of ``recognized``, nats."""
    said, right = of(judged, lambda case: case.kind not in ONLY_CHECKED)
    said = np.clip(said, 1e-4, 1 - 1e-4)
    return float(-np.where(right, np.log(said), np.log(1 - said)).mean())


def show(judged: list[Judged]) -> None:
    """Print all that is known of one kind of features."""
    print(f"  log score: {log_score(judged):.4f}")
    rows = [{"": f"threshold {threshold}"} | figures(judged, threshold) for threshold in THRESHOLDS]
    for recording in dict.fromkeys(one.recording for one in judged):
        chosen = [one for one in judged if one.recording == recording]
        rows.append({"": recording} | figures(chosen, MIN_RECOGNIZED))
    print_table(rows, list(rows[0]))


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument("--features", default=",".join(extractor_names()))
    parser.add_argument("--room", action="append", help="only this one; again for another")
    parser.add_argument("--fit", action="append", help="recording that weights are fitted to; again for another")
    parser.add_argument("--minutes", type=float, default=np.inf, help="of processor time, after which it ends")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    rooms = [one for one in (*ROOMS, *WIDE) if not args.room or one.name in args.room]
    answered, missing = all_answered(
        args.features.split(","), rooms, args.cache, lambda: time.process_time() > 60 * args.minutes
    )
    if answered:
        fitted = [one for one in answered if not args.fit or one.recording in args.fit]
        for name, values in asdict(fit(fitted)).items():
            print(f"{name} that fits all best: {np.round(values, 2).tolist()}")
        without = weights_without((one.recording for one in answered), fitted)
        for recording, weights in without.items():
            print(f"exact without {recording}: {np.round(weights.exact, 2).tolist()}")
        every = {
            "held back": [judge(one, without[one.recording]) for one in answered],
            "in use": [judge(one) for one in answered],
        }
        names = list(dict.fromkeys(one.features for one in answered))
        rows = []
        for name in names:
            print(name)
            show([one for one in every["held back"] if one.features == name])
            for how, judged in every.items():
                chosen = [one for one in judged if one.features == name]
                rows.append({"": f"{name}, {how}", "log score": f"{log_score(chosen):.4f}"})
                rows[-1] |= figures(chosen, MIN_RECOGNIZED)
        print_table(rows, list(rows[0]))
        for exact, said in ((False, "recognized"), (True, "confidence")):
            print_table(reliability_table(every["in use"], exact), [said, "says", *names])
    if missing:
        print(f"{missing} rooms are still to be asked: run it again.")
        raise SystemExit(OUT_OF_TIME)


if __name__ == "__main__":
    main()
