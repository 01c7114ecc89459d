"""Canvas on a pygame surface; colours."""

import functools
import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

if TYPE_CHECKING:
    import pygame

Colour: TypeAlias = tuple[int, ...]
Point: TypeAlias = Sequence[float] | np.ndarray
Points: TypeAlias = Sequence[Point] | np.ndarray
Box: TypeAlias = tuple[float, float, float, float]  # left, top, width, height [px]

SIZE = (960, 540)  # [px]
# Colours: Okabe & Ito, distinct with every kind of colour vision; soil runs from light to dark with
# friction.
WHITE = (255, 255, 255)
PAPER = (250, 250, 248)
INK = (34, 34, 40)
GREY = (112, 112, 120)
GRID = (226, 226, 230)
BLUE = (0, 114, 178)
LIGHT_BLUE = (190, 220, 240)
ORANGE = (213, 94, 0)
LIGHT_ORANGE = (246, 196, 150)
GREEN = (0, 130, 96)
AMBER = (176, 112, 0)
SURFACE = (74, 54, 38)
PURPLE = (150, 50, 130)
LIGHT_PURPLE = (230, 200, 225)
LIGHT_AMBER = (244, 220, 160)
LIGHT_GREEN = (178, 224, 208)
SKY = (232, 240, 246)
RIM = (60, 64, 72)
WHEEL = (238, 239, 242)
SPOKE = (150, 154, 162)
_HEAD = 5.0  # [px] length of the head of an arrow
_HEAD_SHARE = 0.6  # of a short arrow that is head
_HALF_HEAD = 0.6  # half the width of a head over its length
_SHORTEST = 1.0  # [px] of an arrow that is drawn
_OVERLAP = 0.6  # [px] of neighbouring soils, between which the background would show
_RAMP = np.array([(247, 230, 186), (218, 182, 126), (171, 128, 82), (116, 82, 56)], dtype=float)


class Canvas:
    """Drawing surface of `SIZE`, drawn twice as large and shrunk, so that edges are smooth.

    Points [n, 2], lengths and widths are in pixels of the finished picture, y downward. Text is put
    on top of all shapes at the end.
    """

    def __init__(self) -> None:
        import pygame

        pygame.font.init()
        self._pygame = pygame
        self._draw = pygame.draw
        self._large = pygame.Surface((2 * SIZE[0], 2 * SIZE[1]), 0, 32)
        self._surface = pygame.Surface(SIZE, 0, 32)
        self._font = functools.cache(functools.partial(pygame.font.Font, None))  # by height [px]
        # pictures of words by size [px] and colour, the last ones: most return in the next frame
        self._written = functools.lru_cache(400)(
            lambda words, size, colour: self._font(size).render(words, True, colour)
        )
        self._texts: list[tuple[pygame.Surface, np.ndarray]] = []  # with their places

    def _at(self, points):
        """A place, places or a box, in pixels of the large picture, as lists of numbers."""
        return (2.0 * np.asarray(points)).tolist()

    def _width(self, width):
        """Width of a line in pixels of the large picture, at least 1."""
        return max(1, round(2.0 * width))

    def clear(self) -> None:
        """Start a new picture."""
        self._large.fill(PAPER)
        self._texts.clear()

    def clip(self, box: Box | None) -> None:
        """Confine shapes (not text) to a box from here on; None: to the whole picture."""
        self._large.set_clip(box and np.rint(self._at(box)).astype(int).tolist())

    def box(self, box: Box, colour: Colour | None, edge: Colour | None = None) -> None:
        """A rectangle, filled unless `colour` is None, with an edge if a colour is given for it."""
        x, y, w, h = box
        corners = [(x, y), (x + w, y), (x + w, y + h), (x, y + h), (x, y)]
        if colour is not None:
            self.polygon(corners, colour)
        if edge is not None:
            self.lines(corners, edge, 1)

    def polygon(self, points: Points, colour: Colour) -> None:
        """A filled polygon."""
        self._draw.polygon(self._large, colour, self._at(points))

    def lines(self, points: Points, colour: Colour, width: float = 1.5) -> None:
        """A polyline; nothing for fewer than two points."""
        if len(points) > 1:
            self._draw.lines(self._large, colour, False, self._at(points), self._width(width))

    def circle(self, centre: Point, radius: float, colour: Colour, width: float = 0) -> None:
        """A disc, or, where `width` is not 0, a ring of this width inside `radius`."""
        thickness = self._width(width) if width else 0
        self._draw.circle(self._large, colour, self._at(centre), 2.0 * radius, thickness)

    def arrow(self, tail: Point, head: Point, colour: Colour, width: float) -> None:
        """An arrow from `tail` to the tip `head`, with a line of a `width`; nothing where it is
        shorter than `_SHORTEST`.
        """
        along = np.subtract(head, tail)
        length = math.hypot(*along)
        if length >= _SHORTEST:
            along *= min(_HEAD, _HEAD_SHARE * length) / length
            base = head - along
            across = _HALF_HEAD * np.array([-along[1], along[0]])
            self.lines([tail, base], colour, width)
            self.polygon([head, base + across, base - across], colour)

    def soil(
        self, points: np.ndarray, bottom: float, friction: np.ndarray, bounds: tuple[float, float]
    ) -> None:
        """Ground between a surface of `points` [n, 2] and the height `bottom`, with a dark surface.

        `friction` [n - 1] in deg colours the ground between neighbouring points; `bounds` as in
        `soil_colour`.
        """
        colours = soil_colour(friction, bounds)
        x, y = np.transpose(points)
        # One polygon for each run of one colour.
        changes = np.flatnonzero(np.diff(colours, axis=0).any(axis=1)) + 1
        for start, end in itertools.pairwise([0, *changes, len(colours)]):
            right = x[end] + _OVERLAP
            below = [(right, y[end]), (right, bottom), (x[start], bottom)]
            self.polygon([*points[start : end + 1], *below], colours[start])
        self.lines(points, SURFACE)

    def text(
        self, x: float, y: float, words: str, size: int, colour: Colour = INK, align: float = 0.0
    ) -> None:
        """Words of a `size` [px] with their middle line at y; align 0, 0.5 or 1 puts their left
        end, middle or right end at x.
        """
        image = self._written(words, size, colour)
        place = np.array([x, y]) - np.multiply(image.get_size(), (align, 0.5))
        self._texts.append((image, place.round()))

    def finish(self) -> "pygame.Surface":
        """The finished picture as a surface, which the next picture overwrites."""
        self._pygame.transform.smoothscale(self._large, SIZE, self._surface)
        self._surface.blits(self._texts)
        return self._surface


def soil_colour(friction: np.ndarray | list[float], bounds: tuple[float, float]) -> np.ndarray:
    """Colours [n, 3] of soils with friction angles [n] in deg.

    They run from light at the lower of the `bounds` [deg] to dark at the upper one, and are
    constant beyond.
    """
    place = np.linspace(*bounds, len(_RAMP))
    channels = [np.interp(friction, place, channel) for channel in _RAMP.T]
    return np.stack(channels, axis=1).astype(int)
