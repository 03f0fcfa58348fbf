"""Which photographs to take: one after the other, then each exchanged for a better one as long as that helps."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from torch import Tensor

from torchmat.fitting.certainty.expected import Design

MEAN, VOLUME = CRITERIA = ("mean", "D")
_ROUNDS = 3


def choose(design: Design, taken: Sequence[int], possible: Sequence[int], targets: Sequence[int], count: int, criterion: str) -> list[int]:
    """Return `count` of the `possible` pairs to add to those taken: none twice.

    By "mean" they leave the least expected error over the targets, by "D" the least volume to the maps.
    """
    worth = _worth(design, targets, criterion)
    chosen: list[int] = []
    best = float("inf")
    for _ in range(count):
        rest = [number for number in possible if number not in chosen]
        scores = worth([*taken, *chosen], rest)
        chosen.append(rest[int(scores.argmin())])
        best = float(scores.min())
    for _ in range(_ROUNDS if count > 1 else 0):
        before = best
        for place in range(count):
            others = chosen[:place] + chosen[place + 1 :]
            rest = [number for number in possible if number not in others]
            scores = worth([*taken, *others], rest)
            if float(scores.min()) < best * (1 - 1e-9) if best > 0 else float(scores.min()) < best - 1e-9:
                chosen, best = others[:place] + [rest[int(scores.argmin())]] + others[place:], float(scores.min())
        if best == before:
            break
    return in_order(design, taken, chosen, targets, criterion)


def in_order(design: Design, taken: Sequence[int], chosen: Sequence[int], targets: Sequence[int], criterion: str) -> list[int]:
    """Return the chosen pairs with that first which helps most, and so on: whoever stops early has the best of them."""
    worth = _worth(design, targets, criterion)
    ordered: list[int] = []
    while len(ordered) < len(chosen):
        rest = [number for number in chosen if number not in ordered]
        ordered.append(rest[int(worth([*taken, *ordered], rest).argmin())])
    return ordered


def _worth(design: Design, targets: Sequence[int], criterion: str) -> Callable[[Sequence[int], Sequence[int]], Tensor]:
    if criterion == VOLUME:
        return design.volumes
    return lambda chosen, more: design.errors_with(chosen, more, targets).mean(dim=1)

