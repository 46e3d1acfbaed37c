"""How many floating-point operations a training step of Semantic Nerfacto is, term by term, from its settings.

Per step there are R rays with S samples each, and P bins in a round of proposals. A layer of n inputs and m outputs
costs 2 n m operations for a sample: n m products and as many sums. Its way back costs twice that, once for the gradient
of its inputs and once for that of its weights.

Networks of the field: 2L -> H -> G for the density; G -> H -> H -> 3 for the colour, where the direction's F features
enter the first layer once for a ray; G -> H for the semantics, whose C outputs are linear, and so need computing only
once for a ray, after compositing. Networks of the proposals: 2L' -> H' -> 1, which learn every k-th step.

Hash interpolation: 8 corners with 2 features in each of L levels, 32 L operations for a sample, and as many on the way
back, where the gradient is scattered to the corners.

The heads and the way back may be spared for samples without weight: A of the S samples of a ray are active, all of them
in the plain architecture.

Left out, because a limit may be too low but not too high: addresses and weights of the corners, exponentials,
compositing, losses, the optimiser, and all waiting for memory.
"""

from dataclasses import dataclass

from autonerf_lab.nerf.fields.hash_field import HARMONICS
from autonerf_lab.nerf.kernels.tiling import GEOMETRY
from autonerf_lab.nerf.settings import ProposalSettings


@dataclass(frozen=True)
class Term:
    """A part of the work."""

    name: str
    formula: str
    operations: float


def step_operations(settings: ProposalSettings, classes: int, active: float = 1.0) -> list[Term]:
    """The terms of a training step.

    Args:
        settings: sizes of the model, rays and samples of a step.
        classes: what the semantic network tells apart.
        active: share of the samples that go through the heads and back.
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
    """Of a whole step."""
    return sum(term.operations for term in terms)


def describe(settings: ProposalSettings, classes: int) -> str:
    """The formulas with their values when every sample is active, as a table."""
    s, terms = settings, step_operations(settings, classes)
    lines = [
        f"R {s.rays}  S = A {s.samples}  L {s.levels}  H {s.hidden}  G {GEOMETRY}  F {HARMONICS + s.appearance}  "
        f"C {classes}  P {', '.join(map(str, s.proposal_samples))}  L' {s.proposal_levels}  H' {s.proposal_hidden}  "
        f"k {s.proposal_every}"
    ]
    lines += [f"  {term.name:<28}{term.formula:<30}{term.operations / 1e6:>9.1f} MFLOP" for term in terms]
    lines.append(f"  {'a training step':<58}{total_operations(terms) / 1e6:>9.1f} MFLOP")
    return "\n".join(lines)
