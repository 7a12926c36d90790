"""Whom to cite: the works that data sets of this toolkit stand on."""

from __future__ import annotations

__all__ = ["HWD_PLUS", "MNIST", "TACTILE_MNIST", "bibtex"]

TACTILE_MNIST = """\
@article{schneider2025tactilemnist,
  title  = {Tactile {MNIST}: Benchmarking Active Tactile Perception},
  author = {Schneider, Tim and Duret, Guillaume and de Farias, Cristiana and Calandra, Roberto and
            Chen, Liming and Peters, Jan},
  year   = {2025}
}"""
"""The paper: algorithm, splits, scenes and touches."""

HWD_PLUS = """\
@article{beaulac2022hwdplus,
  title   = {Introducing a New High-Resolution Handwritten Digits Data Set with Writer Characteristics},
  author  = {Beaulac, C{\\'e}dric and Rosenthal, Jeffrey S.},
  journal = {SN Computer Science},
  year    = {2022},
  doi     = {10.1007/s42979-022-01494-2}
}"""
"""The handwriting of the published digits."""

MNIST = """\
@article{lecun1998gradient,
  title   = {Gradient-Based Learning Applied to Document Recognition},
  author  = {LeCun, Yann and Bottou, L{\\'e}on and Bengio, Yoshua and Haffner, Patrick},
  journal = {Proceedings of the IEEE},
  volume  = {86},
  number  = {11},
  pages   = {2278--2324},
  year    = {1998},
  doi     = {10.1109/5.726791}
}"""
"""The handwriting of MNIST."""


def bibtex(*entries: str) -> str:
    """Lay out entries as one block of BibTeX in Markdown."""
    return "```bibtex\n" + "\n\n".join(entries) + "\n```"
