"""Singular values that are found on every computer."""

import numpy as np


def svd(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Left vectors, singular values and right vectors of a matrix.

    The fast driver of LAPACK fails for some matrices whose singular values are equal, such as orders over whole turns;
    the other one is slower and always converges.

    Args:
        matrix: (n, p).
    """
    try:
        left, size, right = np.linalg.svd(matrix, full_matrices=False)
    except np.linalg.LinAlgError:
        from scipy import linalg

        left, size, right = linalg.svd(matrix, full_matrices=False, lapack_driver="gesvd")
    return left, size, right
