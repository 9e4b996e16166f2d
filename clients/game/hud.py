"""Texts over the picture: score, measurements, the state of the stream, help."""

from __future__ import annotations

import math
from functools import lru_cache

import pygame
from adverb_client import Sample
from fighter import Fighter
from match import BALLS, Match

TEXT, DIM, GOOD, FAR, BAD = (236, 240, 248), (158, 168, 186), (120, 232, 150), (255, 196, 84), (255, 118, 96)
PANEL = (14, 17, 26, 190)

HELP = (
    "left click   throw a ball to strike; low ones are kicked",
    "right click   throw a soft ball to catch",
    "wheel   nearer or farther       arrow keys   look around",
    "P   pause       R   restart       H   hide this help       Esc   leave",
)


@lru_cache
def font_of(size: int) -> pygame.font.Font:
    """A font, looked up once."""
    return pygame.font.SysFont("dejavusans,arial", size)


def draw_score(screen: pygame.Surface, match: Match, fighter: Fighter) -> None:
    """Score, round and what the figure does, at the top right."""
    last = match.results[-1].miss_m if match.results else math.nan
    rows = [
        ("round", f"{match.round}", TEXT),
        ("balls left", f"{BALLS - match.thrown}", TEXT),
        ("met", f"{match.met} of {len(match.results)}", TEXT),
        ("in a row", f"{match.combo}", GOOD if match.combo > 1 else TEXT),
        ("last miss", _millimetres(last), TEXT),
        ("mean miss", _millimetres(match.mean_miss_m), TEXT),
        ("figure", fighter.doing, FAR if fighter.attempt else TEXT),
    ]
    panel = pygame.Surface((230, 74 + 23 * len(rows)), pygame.SRCALPHA)
    pygame.draw.rect(panel, PANEL, panel.get_rect(), border_radius=12)
    score = font_of(34).render(f"{match.score}", True, TEXT)
    panel.blit(score, (212 - score.get_width(), 12))
    panel.blit(font_of(15).render("score", True, DIM), (18, 28))
    _rows(panel, rows, 62)
    screen.blit(panel, (screen.get_width() - 248, 18))


def draw_stream(screen: pygame.Surface, fighter: Fighter, sample: Sample | None, fps: float) -> None:
    """The state of the stream, at the top left."""
    stream, stats = fighter.stream, fighter.stream.stats
    error = math.nan if sample is None else sample.error
    delay = math.nan if sample is None else sample.delay_s
    rows = [
        ("stream", *(("live", GOOD) if stream.live else ("reconnecting", BAD))),
        ("round trip", _milliseconds(stream.clock.round_trip_s), TEXT),
        ("pose age + delay", f"{1e3 * stream.age_s:.0f} + {_milliseconds(delay)}", TEXT),
        ("error of the pose", _micrometres(error) if fighter.attempt else "–", TEXT),
        ("dropped / missing", f"{stats.dropped} / {stats.missing}", TEXT),
        ("errors", f"{stats.decode_errors + fighter.errors}", BAD if fighter.errors else TEXT),
        ("frames per second", f"{fps:.0f}", TEXT),
    ]
    panel = pygame.Surface((270, 28 + 23 * len(rows)), pygame.SRCALPHA)
    pygame.draw.rect(panel, PANEL, panel.get_rect(), border_radius=12)
    _rows(panel, rows, 14)
    screen.blit(panel, (18, 18))


def draw_help(screen: pygame.Surface) -> None:
    """The controls, at the bottom left."""
    panel = pygame.Surface((460, 20 + 22 * len(HELP)), pygame.SRCALPHA)
    pygame.draw.rect(panel, PANEL, panel.get_rect(), border_radius=12)
    for k, line in enumerate(HELP):
        panel.blit(font_of(14).render(line, True, DIM), (16, 10 + 22 * k))
    screen.blit(panel, (18, screen.get_height() - panel.get_height() - 18))


def draw_banner(screen: pygame.Surface, text: str) -> None:
    """A large text in the middle."""
    shown = font_of(40).render(text, True, TEXT)
    place = shown.get_rect(center=(screen.get_width() // 2, screen.get_height() // 3))
    panel = pygame.Surface((place.width + 60, place.height + 30), pygame.SRCALPHA)
    pygame.draw.rect(panel, PANEL, panel.get_rect(), border_radius=14)
    screen.blit(panel, (place.left - 30, place.top - 15))
    screen.blit(shown, place)


def _rows(panel: pygame.Surface, rows: list[tuple[str, str, tuple[int, int, int]]], top: int) -> None:
    for k, (name, value, colour) in enumerate(rows):
        panel.blit(font_of(15).render(name, True, DIM), (18, top + 23 * k))
        text = font_of(15).render(value, True, colour)
        panel.blit(text, (panel.get_width() - 18 - text.get_width(), top + 23 * k))


def _millimetres(metres: float) -> str:
    return "–" if math.isnan(metres) else f"{1e3 * metres:.0f} mm"


def _micrometres(metres: float) -> str:
    return "–" if math.isnan(metres) else f"{1e6 * metres:.1f} µm"


def _milliseconds(seconds: float) -> str:
    return "–" if math.isnan(seconds) else f"{1e3 * seconds:.1f} ms"
