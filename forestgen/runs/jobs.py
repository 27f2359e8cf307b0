"""Which images are still to be made, in order; drawn as their turn comes, so that the first one need not wait."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping

from forestgen.core.errors import ForestgenError
from forestgen.recipe.dataset import split_of
from forestgen.runs.contract import Failed, Job, Place, Work
from forestgen.runs.folder import Known, forget_key
from forestgen.runs.keys import job_key


class JobQueue:
    """Jobs with their attempts; those that are tried again come first.

    Parameters
    ----------
    images : numbers of the images that are wanted.
    splits : name -> share.
    known : the images whose records are there. A stale one is forgotten when its turn comes.
    """

    def __init__(self, work: Work, images: range, splits: Mapping[str, float], known: Known) -> None:
        self._loaded, self._versions = work.loaded, work.versions
        self._place: Place = work.place
        self._images, self._splits, self._known = images, splits, known
        self._again: deque[tuple[Job, int]] = deque()
        self._fresh = self._draw_all()
        self.done = len(known.keys) - len(known.stale)
        self.keys: dict[int, str] = {}  # image -> key, of all images that have had their turn

    def next(self) -> tuple[Job, int] | Failed | None:
        """A job and its attempt; an image that cannot be drawn; None if there is nothing to hand out now."""
        if self._again:
            return self._again.popleft()
        return next(self._fresh, None)

    def again(self, job: Job, attempt: int) -> None:
        """Try a job again, before all others."""
        self._again.append((job, attempt))

    def all_jobs(self) -> list[Job]:
        """Of every image that was handed out or known, by image."""
        return [self._job(image, self.keys[image]) for image in self._images]

    def _draw_all(self) -> Iterator[tuple[Job, int] | Failed]:
        for image in self._images:
            known = self._known.keys.get(image)
            if known is not None and image not in self._known.stale:
                self.keys[image] = known
                continue
            if known is not None:
                forget_key(self._place, known)
            drawn = self._draw(image)
            self.keys[image] = "" if isinstance(drawn, Failed) else drawn.key
            yield drawn if isinstance(drawn, Failed) else (drawn, 1)

    def _draw(self, image: int) -> Job | Failed:
        try:
            drawn = self._loaded.draw(image - self._images.start)
        except ForestgenError as error:  # a drawn value that the schema rejects
            return Failed(self._job(image, ""), 1, "recipe", str(error), error=error)
        return self._job(image, job_key(drawn, self._versions))

    def _job(self, image: int, key: str) -> Job:
        return Job(image - self._images.start, image, split_of(self._splits, image), key)
