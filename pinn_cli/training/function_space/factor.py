"""Cholesky factors of matrices so large that one call of the library would keep a signal waiting for minutes."""

from __future__ import annotations

import torch
from torch import Tensor

# Rows of a panel: between two panels Python looks at signals, three seconds of one core apart for 30 000 rows.
PANEL = 1024


def cholesky(matrix: Tensor) -> Tensor | None:
    """Lower Cholesky factor of a symmetric matrix (M, M), whose lower triangle is read; None where there is none.

    From four panels on the matrix is overwritten, panel after panel (right-looking; Golub and Van Loan 2013, section
    4.2.9): as many operations as in one call, and a tenth more time for 6000 rows.
    """
    if len(matrix) < 4 * PANEL:
        factor, failed = torch.linalg.cholesky_ex(matrix)
        return None if int(failed) else factor
    panels = [slice(first, min(first + PANEL, len(matrix))) for first in range(0, len(matrix), PANEL)]
    for number, panel in enumerate(panels):
        top, failed = torch.linalg.cholesky_ex(matrix[panel, panel])
        if int(failed):
            return None
        matrix[panel, panel] = top
        below = matrix[panel.stop :, panel]
        below.copy_(torch.linalg.solve_triangular(top, below.mT, upper=False).mT)
        for columns in panels[number + 1 :]:
            matrix[columns.start :, columns].addmm_(matrix[columns.start :, panel], matrix[columns, panel].mT, alpha=-1)
    return matrix.tril_()
