"""Number of floating-point operations of a training step of Semantic Nerfacto, term by term, from its settings.

A step has R rays with S samples each, and P bins in a proposal round. A layer of n inputs and m outputs costs 2 n m
operations per sample: n m products and as many sums. Its backward pass costs twice that, for the gradients of inputs
and weights.

Networks of the field: 2L -> H -> G for the density; G -> H -> H -> 3 for the colour, where the F features of the
direction enter the first layer once per ray; G -> H for the semantics, whose C outputs are linear and so are computed
once per ray, after compositing. Networks of the proposals: 2L' -> H' -> 1, trained every k-th step.

Hash interpolation: 8 corners with 2 features in each of L levels, 32 L operations per sample, and as many in the
backward pass, which scatters the gradient to the corners.

Heads and backward pass can be skipped for samples without weight: A of the S samples of a ray are active; A = S in the
plain architecture.

Not counted, so that the result is a lower bound: addresses and weights of the corners, exponentials, compositing,
losses, the optimiser, and memory access.
"""

from dataclasses import dataclass

from autonerf_lab.nerf.fields.hash_field import HARMONICS
from autonerf_lab.nerf.kernels.tiling import GEOMETRY
from autonerf_lab.nerf.settings import ProposalSettings


@dataclass(frozen=True)
class Term:
    """One term of the sum."""

    name: str
    formula: str
    operations: float  # per training step


def step_operations(settings: ProposalSettings, classes: int, active: float = 1.0) -> list[Term]:
    """Return the terms of a training step.

    Args:
        settings: sizes of the model, rays and samples of a step.
        classes: number of semantic classes.
        active: share of the samples that pass through the heads and the backward pass.
    """
    s = settings
    R, S, H, L, G, F, C = s.rays, s.samples, s.hidden, s.levels, GEOMETRY, HARMONICS + s.appearance, classes
    A, h, levels, k = active * S, s.proposal_hidden, s.proposal_levels, s.proposal_every
    terms = [
        Term("density network", "R (2 S + 4 A) (2L H + H G)", R * (2 * S + 4 * A) * (2 * L * H + H * G)),
        Term("colour network, samples", "6 R A (G H + H H + 3 H)", 6 * R * A * (G * H + H * H + 3 * H)),
        Term("colour network, rays", "6 R F H", 6 * R * F * H),
        Term("semantic network, samples", "6 R A G H", 6 * R * A * G * H),
        Term("semantic network, rays", "6 R H C", 6 * R * H * C),
        Term("hash interpolation", "32 R (S + A) L", 32 * R * (S + A) * L),
    ]
    for i, P in enumerate(s.proposal_samples):
        network = (2 + 4 / k) * R * P * (2 * levels * h + h)
        terms.append(Term(f"proposal {i}, network", "(2 + 4/k) R P (2L' H' + H')", network))
        terms.append(Term(f"proposal {i}, interpolation", "(32 + 32/k) R P L'", (32 + 32 / k) * R * P * levels))
    return terms


def total_operations(terms: list[Term]) -> float:
    """Return the number of operations of a step."""
    return sum(term.operations for term in terms)


def describe(settings: ProposalSettings, classes: int) -> str:
    """Return a table of the terms, with all samples active."""
    s, terms = settings, step_operations(settings, classes)
    lines = [
        f"R {s.rays}  S = A {s.samples}  L {s.levels}  H {s.hidden}  G {GEOMETRY}  F {HARMONICS + s.appearance}  "
        f"C {classes}  P {', '.join(map(str, s.proposal_samples))}  L' {s.proposal_levels}  H' {s.proposal_hidden}  "
        f"k {s.proposal_every}"
    ]
    lines += [f"  {term.name:<28}{term.formula:<30}{term.operations / 1e6:>9.1f} MFLOP" for term in terms]
    lines.append(f"  {'a training step':<58}{total_operations(terms) / 1e6:>9.1f} MFLOP")
    return "\n".join(lines)
