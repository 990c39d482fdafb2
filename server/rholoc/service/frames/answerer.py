"""Answers frames in compute threads, each by its deadline."""

import asyncio
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeVar

from starlette.concurrency import run_in_threadpool

from rholoc.errors import DeadlineExceeded, RholocError, StorageUnavailable
from rholoc.library.maps import MapLibrary
from rholoc.library.sites import SiteLibrary
from rholoc.localization import AnyLocalizer, MapFinder
from rholoc.service.caller import ASKER
from rholoc.service.frames.answer_models import LocalizationOut, PlacesOut, late_answer
from rholoc.service.frames.geoposes import GeoPoseKind
from rholoc.service.frames.kept.learning import Learner
from rholoc.service.frames.kept.live import Live
from rholoc.service.frames.kept.refusals import LikenessOut, Refusal, Refusals, likeness
from rholoc.service.frames.landscape import LandscapeOut, landscape_of
from rholoc.service.frames.localizers import Localizers, LocalizerSource, MapNotHereError
from rholoc.service.frames.map_choice import MapChoice
from rholoc.service.frames.queries import Frame
from rholoc.service.frames.several_frames import Frames, localize_frames
from rholoc.service.frames.single_frame import likeliest_places, localize_frame
from rholoc.service.frames.site_answers import on_earth
from rholoc.service.http.metrics import Metrics
from rholoc.service.http.stopwatch import Stopwatch, frame_deadline_s
from rholoc.service.settings import Settings
from rholoc.service.threads.compute import ComputePool, Effort
from rholoc.service.threads.storage import StorageLanes

T = TypeVar("T")

_FETCHING_S = 1.0  # maximum wait for one of several maps, before it is skipped
_LOADING_GRACE_S = 0.5  # extension of the deadline for a map that was not in memory


@dataclass(frozen=True)
class Answerer:
    """Answers frames. Use it from the event loop only.

    Attributes:
        settings: of the service.
        library, sites: the maps, and the sites for poses in their frames.
        localizers: of the maps.
        finder: chooses from many maps.
        compute: threads for localization.
        learner, live, refusals, metrics: observers of answers.
        lanes: threads for looking up and fetching maps.
    """

    settings: Settings
    library: MapLibrary
    sites: SiteLibrary
    localizers: Localizers
    finder: MapFinder
    compute: ComputePool
    learner: Learner
    live: Live
    refusals: Refusals
    metrics: Metrics
    lanes: StorageLanes

    async def check_known(self, names: Iterable[str]) -> None:
        """Refuse unknown maps before a request enters the queue, without disk access for known ones.

        Raises:
            InvalidName, UnknownMap: by the library.
        """
        for name in names:
            if not self.library.is_known(name):
                await self.lanes.files(self.library.stat, name)

    async def localizer(self, name: str) -> AnyLocalizer:
        """The localizer of a map; fetches the map if necessary. Raises InvalidName, UnknownMap, InvalidMap,
        StorageUnavailable, StorageFull.
        """
        if not await self.lanes.files(self.library.is_here, name):
            await self.lanes.fetches(self.library.path, name)
        return await self.lanes.files(self.localizers.get, name)

    async def forget_missing(self) -> None:
        """Drop the localizers of maps that are no longer in the library."""
        await self.lanes.files(self.localizers.forget_missing)

    async def localize(self, frame: Frame, maps: MapChoice, clock: Stopwatch, private: bool = False) -> LocalizationOut:
        """The most confident answer of several maps for one frame; at the deadline one without a pose.

        It is counted. Of a ``private`` frame neither picture nor features are kept, and it is not shown live.

        Raises:
            DeadlineExceeded: the deadline passed while the map was being loaded.
            Busy: too many frames wait. UnknownMap, InvalidMap, InvalidImage, InvalidCamera, InvalidDescriptors,
                InvalidInput: what was sent is not valid.
        """
        listener = None if private else self.learner.listener(ASKER.get())
        prior = frame.options.prior
        answer = await self._by_deadline(
            lambda localizers: localize_frame(frame, maps, localizers, self.settings, clock, listener),
            maps,
            clock,
            frame_deadline_s(frame.options.deadline_ms, self.settings),
            frame.effort,
            frame.options.geopose,
        )
        if private:
            return answer
        self.live.note(answer, None if prior is None else prior.position)
        if self.refusals.wanted and frame.image is not None:
            await run_in_threadpool(self.refusals.keep, answer, frame.image)
        return answer

    async def likeness(self, refusal: Refusal) -> LikenessOut:
        """The view of its map that a refused picture resembles most. Raises Busy, UnknownMap, InvalidMap."""
        return await self._compute(lambda localizers: likeness(localizers.get(refusal.map), refusal), Effort.LARGE)

    async def localize_together(self, frames: Frames, maps: MapChoice, clock: Stopwatch) -> LocalizationOut:
        """The most confident answer of several maps for several frames: the first frame's pose. Raises and ends at the
        deadline as :meth:`localize`.
        """
        deadline_s = frame_deadline_s(frames.query.deadline_ms, self.settings)
        answer = await self._by_deadline(
            lambda localizers: localize_frames(frames, maps, localizers, self.settings, clock, deadline_s),
            maps,
            clock,
            deadline_s,
            Effort.LARGE,
            frames.query.geopose,
        )
        self.live.note(answer, None)
        return answer

    async def places(self, frame: Frame, maps: MapChoice, clock: Stopwatch, most: int) -> PlacesOut:
        """The views that a frame resembles most, at most ``most``, best first. Raises errors of :meth:`localize`."""
        await self.check_known(maps.names if maps.named else ())
        return await self._compute(
            lambda localizers: likeliest_places(frame, maps, localizers, self.settings, clock, most),
            frame.effort,
            maps.named,
        )

    async def landscape(self, frame: Frame, name: str, clock: Stopwatch) -> LandscapeOut:
        """Landscape of a map's densities around a frame's pose. Raises Busy, DeadlineExceeded, and the
        errors of :meth:`localize`.
        """
        return await self._compute(
            lambda localizers: landscape_of(frame, name, localizers, self.settings, clock), Effort.LARGE
        )

    async def _by_deadline(
        self,
        localize: Callable[[LocalizerSource], LocalizationOut],
        maps: MapChoice,
        clock: Stopwatch,
        deadline_s: float,
        effort: Effort,
        geopose: GeoPoseKind | None,
    ) -> LocalizationOut:
        """Answer of ``localize`` in a thread, with the pose in a site and on Earth; without a pose at the deadline. It
        is counted. Raises Busy, and as ``localize``.
        """

        def work(localizers: LocalizerSource) -> LocalizationOut:
            answer = localize(localizers)
            own = None if geopose is None or not answer.localized else localizers.get(answer.map).map.info.earth
            return on_earth(answer, self.sites, maps.site, own, geopose)

        await self.check_known(maps.names if maps.named else ())
        try:
            async with asyncio.timeout(deadline_s - clock.elapsed_s):
                answer = await self._compute(
                    work,
                    effort,
                    maps.named,
                    lambda answer: answer.localized,
                )
        except (TimeoutError, DeadlineExceeded):
            answer = await self._late(maps.first, clock)
        self.metrics.localization(answer.map, answer.reason, answer.timings_ms)
        return answer

    async def _late(self, name: str, clock: Stopwatch) -> LocalizationOut:
        """The answer without a pose at the deadline. Raises DeadlineExceeded if the map is not loaded 0.5 s later."""
        try:
            async with asyncio.timeout(_LOADING_GRACE_S):
                localizer = await self.localizer(name)
        except (TimeoutError, MapNotHereError, StorageUnavailable):
            raise DeadlineExceeded("The deadline passed while the map was being loaded.", "Try again.") from None
        return late_answer(name, localizer, clock)

    async def _compute(
        self,
        work: Callable[[LocalizerSource], T],
        effort: Effort,
        needs_all: bool = True,
        is_useful: Callable[[T], bool] = lambda result: True,
    ) -> T:
        """The result of ``work`` in a compute thread; restarted whenever a map had to be fetched first. Raises Busy.

        Args:
            work: function of the localizers.
            effort: of the work.
            needs_all: whether to wait for a map that takes over a second to fetch; otherwise ``work`` gets an error for
                it.
            is_useful: whether a result is of use to the client, for the pool's statistics.
        """
        localizers, patience_s = _RequestLocalizers(self.localizers), None if needs_all else _FETCHING_S
        while True:
            try:
                return await self.compute.run(lambda: work(localizers), effort, is_useful)
            except MapNotHereError as missing:
                name = missing.name
            try:
                async with asyncio.timeout(patience_s):
                    await self.lanes.fetches(self.library.path, name)
            except RholocError as error:
                localizers.refused[name] = error
            except TimeoutError:
                hint = "It is being fetched: try again soon."
                localizers.refused[name] = StorageUnavailable(f"The map {name} is not on this server yet.", hint)


class _RequestLocalizers:
    """The localizers for one request, with the errors of maps that could not be fetched for it."""

    def __init__(self, localizers: Localizers) -> None:
        self._localizers = localizers
        self.refused: dict[str, RholocError] = {}

    def get(self, name: str) -> AnyLocalizer:
        """The localizer of a map. Raises the error noted for it, else as :meth:`Localizers.get`."""
        if name in self.refused:
            raise self.refused[name]
        return self._localizers.get(name)
