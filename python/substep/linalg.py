"""Sparse linear algebra: Cholesky, LU, conjugate gradients and BiCGSTAB.

The solvers of the implicit methods of substep, for everyone. A matrix is anything with `tocsc()`
(SciPy's sparse matrices and arrays), the tuple `(data, indices, indptr)` of compressed columns, or
a dense array. Results are the same bits for any number of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _core
from .base.checks import (
    check_array,
    check_choice,
    check_flag,
    check_integer,
    check_real,
    check_sparse,
)
from .base.owned import Owned
from .errors import ConvergenceError, InputError, NonFiniteError

__all__ = ["LU", "Cholesky", "CholeskyReport", "KrylovResult", "LUReport", "bicgstab", "cg"]


def __dir__() -> list[str]:
    return __all__


_SYMMETRY = 1e-10  # of the largest entry: how far a matrix called symmetric may be from it


class _Columns(NamedTuple):
    """A square matrix in compressed columns, rows ascending."""

    n: int
    start: NDArray[np.int32]
    row: NDArray[np.int32]
    values: NDArray[Any]


def _compressed(data: Any, indices: Any, indptr: Any, rows: int | None) -> _Columns:
    start = check_array("A.indptr", indptr, (None,)).astype(np.int64)
    row = check_array("A.indices", indices, (None,)).astype(np.int64)
    values = check_array("A.data", data, (None,), complex_ok=True, finite=False)
    n = len(start) - 1
    if n < 0 or start[0] != 0 or (np.diff(start) < 0).any() or start[-1] != len(row):
        raise InputError("A.indptr: expected rising numbers from 0 to the number of indices")
    if len(values) != len(row):
        raise InputError(f"A.data: expected shape ({len(row)},), got {values.shape}")
    if rows is not None and rows != n:
        raise InputError(f"A: expected a square matrix, got shape ({rows}, {n})")
    if max(n, len(row)) > 2**31 - 1:
        raise InputError("A: expected fewer than 2**31 rows and entries")
    if len(row) and (row.min() < 0 or row.max() >= n):
        raise InputError(f"A.indices: expected integers from 0 to {n - 1}")
    column = np.repeat(np.arange(n), np.diff(start))
    key = column * max(n, 1) + row
    if (np.diff(key) <= 0).any():  # not sorted, or entries that come twice and are added
        key, slot = np.unique(key, return_inverse=True)
        summed = np.zeros(len(key), values.dtype)
        np.add.at(summed, slot.ravel(), values)
        values, row = summed, key % max(n, 1)
        start = np.searchsorted(key, np.arange(n + 1) * max(n, 1))
    return _Columns(n, start.astype(np.int32), row.astype(np.int32), values)


def _columns(A: Any) -> _Columns:
    """Convert what the caller calls a matrix; NaN and infinity are found by whoever solves."""
    if hasattr(A, "tocsc"):
        csc = check_sparse("A", A).tocsc()
        return _compressed(csc.data, csc.indices, csc.indptr, int(csc.shape[0]))
    if isinstance(A, tuple) and len(A) == 3:
        return _compressed(*A, None)
    dense = check_array("A", A, (None, None), complex_ok=True, finite=False)
    if dense.shape[0] != dense.shape[1]:
        raise InputError(f"A: expected a square matrix, got shape {dense.shape}")
    column, row = np.nonzero(dense.T)
    start = np.searchsorted(column, np.arange(dense.shape[0] + 1))
    return _compressed(dense[row, column], row, start, None)


def _symmetric(A: Any) -> _Columns:
    columns = _columns(A)
    if columns.values.dtype.kind == "c":
        raise TypeError("A: expected real numbers, got dtype complex128; use LU")
    _check_finite(columns)
    k = _core.find_asymmetry(columns.start, columns.row, columns.values, _SYMMETRY)
    if k >= 0:
        i, j = int(columns.row[k]), int(np.searchsorted(columns.start, k, side="right")) - 1
        raise InputError(f"A: expected a symmetric matrix, but A[{i}, {j}] is not A[{j}, {i}]")
    return columns


def _check_finite(columns: _Columns) -> None:
    bad = ~np.isfinite(columns.values)
    if bad.any():
        k = int(np.argmax(bad))
        i, j = int(columns.row[k]), int(np.searchsorted(columns.start, k, side="right")) - 1
        raise NonFiniteError(f"A[{i}, {j}] is {columns.values[k]}", index=i)


def _vector(name: str, value: Any, n: int, *, complex_ok: bool = False) -> NDArray[Any]:
    array = check_array(name, value, (n,), complex_ok=complex_ok, finite=False)
    if not np.isfinite(array).all():
        i = int(np.argmin(np.isfinite(array)))
        raise NonFiniteError(f"{name}[{i}] is {array[i]}", index=i)
    return array


def _right_sides(b: Any, n: int, *, complex_ok: bool = False) -> NDArray[Any]:
    """One right-hand side per row, whether `b` is (n,) or (n, k)."""
    array = check_array("b", b, None, complex_ok=complex_ok, finite=False)
    if array.ndim not in (1, 2) or array.shape[0] != n:
        raise InputError(f"b: expected shape ({n},) or ({n}, k), got {array.shape}")
    if not np.isfinite(array).all():
        i = int(np.argwhere(~np.isfinite(array))[0][0])
        raise NonFiniteError(f"b: row {i} is not finite", index=i)
    return np.ascontiguousarray(array.T)


def _solution(rows: NDArray[Any]) -> NDArray[Any]:
    """Of `_right_sides`, in the shape of `b`; where it is beyond float64 it is none."""
    x = np.ascontiguousarray(rows.T)
    if not np.isfinite(x).all():
        i = int(np.argwhere(~np.isfinite(x))[0][0])
        raise NonFiniteError(f"x: row {i} is not finite: the matrix is nearly singular", index=i)
    return x


class _Factors(Owned):
    """Of the matrix given last; a pattern is analysed where it is another one than before."""

    _native: Any
    _matrix: _Columns
    _analyses = _factorizations = 0

    def _take(self, matrix: _Columns) -> None:
        """Factorize; where that fails, the factors are those of before."""
        known = self._factorizations > 0 and _alike(matrix, self._matrix)
        native = self._native if known else self._analyse(matrix)
        try:
            native.factor(self._entries(matrix))
            self.__dict__.update(
                _native=native,
                _matrix=matrix,
                _analyses=self._analyses + (not known),
                _factorizations=self._factorizations + 1,
            )
        except BaseException:
            if known:
                native.factor(self._entries(self._matrix))
            raise

    def _analyse(self, matrix: _Columns) -> Any:
        raise NotImplementedError

    def _entries(self, matrix: _Columns) -> NDArray[Any]:
        return matrix.values


def _alike(a: _Columns, b: _Columns) -> bool:
    same_pattern = np.array_equal(a.start, b.start) and np.array_equal(a.row, b.row)
    return same_pattern and a.values.dtype == b.values.dtype


@dataclass(frozen=True)
class CholeskyReport:
    """What a Cholesky factorization did.

    Attributes
    ----------
    positive_definite : bool
        Whether the factor exists, and with it `solve`.
    column : int or None
        Where the matrix turned out not to be positive definite.
    kind : str
        "supernodal" or "simplicial".
    ordering : str
        "amd", "metis" or "natural".
    factor_entries : float
        Nonzeros of L.
    flops : float
        Floating-point operations of one factorization.
    analyses, factorizations : int
        How often this object has analysed a pattern, and factorized.
    """

    positive_definite: bool
    column: int | None
    kind: str
    ordering: str
    factor_entries: float
    flops: float
    analyses: int
    factorizations: int


class Cholesky(_Factors):
    """A = L L^T for a symmetric positive definite sparse matrix, by CHOLMOD.

    The pattern is analysed once; `factor` takes new values. That a matrix is not positive definite
    is an answer, in `report`, and an error only for `solve`.

    Parameters
    ----------
    A : sparse matrix, tuple or (n, n) array_like
        See the module. Both triangles are needed.
    ordering : {"automatic", "amd", "metis", "natural"}
        Order of elimination.
    kind : {"automatic", "simplicial", "supernodal"}
        Column by column, or by dense blocks, which pays for large meshes.
    block : int
        Unknowns per vertex, numbered together: the vertices are then ordered, which is quicker and
        better. It must divide n.

    Attributes
    ----------
    report : CholeskyReport
        What was done.

    Raises
    ------
    InputError
        If `A` is not square or not symmetric.
    NonFiniteError
        If `A` holds NaN or infinity.
    MemoryError
        If there is too little memory; the object can be used again.

    References
    ----------
    Chen, Davis, Hager, Rajamanickam, "Algorithm 887: CHOLMOD, supernodal sparse Cholesky
    factorization and update/downdate", ACM Transactions on Mathematical Software 35 (2008) 22.

    Examples
    --------
    >>> import numpy as np
    >>> from substep.linalg import Cholesky
    >>> chain = 2.0 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1)
    >>> Cholesky(chain).solve([1.0, 0.0, 0.0, 1.0]).round(12)
    array([1., 1., 1., 1.])
    >>> Cholesky(chain - 3.0 * np.eye(4)).report.positive_definite
    False
    """

    def __init__(
        self,
        A: Any,
        *,
        ordering: str = "automatic",
        kind: str = "automatic",
        block: int = 1,
    ) -> None:
        self._options = (
            check_choice("ordering", ordering, ("automatic", "amd", "metis", "natural")),
            check_choice("kind", kind, ("automatic", "simplicial", "supernodal")),
            check_integer("block", block, minimum=1, maximum=2**31 - 1),
        )
        self._take(_symmetric(A))

    def _analyse(self, matrix: _Columns) -> Any:
        return _core.CholeskyFactor(matrix.start, matrix.row, *self._options)

    def _entries(self, matrix: _Columns) -> NDArray[Any]:
        column = np.repeat(np.arange(matrix.n, dtype=np.int32), np.diff(matrix.start))
        lower: NDArray[Any] = matrix.values[matrix.row >= column]
        return lower

    def factor(self, A: Any) -> CholeskyReport:
        """Factorize another matrix; the analysis is kept where the pattern is the same.

        Parameters
        ----------
        A : sparse matrix, tuple or (n, n) array_like
            The matrix.

        Returns
        -------
        CholeskyReport
            Also in `report`.

        Raises
        ------
        InputError
            If `A` is not square or not symmetric.
        NonFiniteError
            If `A` holds NaN or infinity.

        Examples
        --------
        >>> import numpy as np
        >>> from substep.linalg import Cholesky
        >>> cholesky = Cholesky(np.diag([1.0, 4.0]))
        >>> cholesky.factor(np.diag([2.0, 8.0])).analyses
        1
        """
        self._take(_symmetric(A))
        return self.report

    def solve(self, b: ArrayLike) -> NDArray[np.float64]:
        """Solve A x = b.

        Parameters
        ----------
        b : (n,) or (n, k) array_like
            Right-hand sides.

        Returns
        -------
        ndarray
            Of the shape of `b`.

        Raises
        ------
        SingularMatrixError
            If the matrix was not positive definite; `index` is the row.
        NonFiniteError
            If `b` holds NaN or infinity, or the solution would.

        Examples
        --------
        >>> from substep.linalg import Cholesky
        >>> Cholesky([[4.0, 0.0], [0.0, 2.0]]).solve([8.0, 8.0])
        array([2., 4.])
        """
        return _solution(self._native.solve(_right_sides(b, self._matrix.n)))

    @property
    def report(self) -> CholeskyReport:
        """What was done."""
        entries = self._native.report()
        entries["column"] = entries["column"] if entries["column"] >= 0 else None
        entries["analyses"] = self._analyses
        entries["factorizations"] = self._factorizations
        return CholeskyReport(**entries)


@dataclass(frozen=True)
class LUReport:
    """What an LU factorization did.

    Attributes
    ----------
    kind : str
        "umfpack" or "klu".
    factor_entries : float
        Nonzeros of L and U.
    rcond : float
        min |u_ii| / max |u_ii|, a cheap estimate of 1 / cond(A).
    analyses, factorizations : int
        How often this object has analysed a pattern, and factorized.
    """

    kind: str
    factor_entries: float
    rcond: float
    analyses: int
    factorizations: int


class LU(_Factors):
    """P A Q = L U for a square sparse matrix, real or complex, by UMFPACK or KLU.

    The pattern is analysed once; `factor` takes new values.

    Parameters
    ----------
    A : sparse matrix, tuple or (n, n) array_like
        See the module.
    kind : {"automatic", "umfpack", "klu"}
        UMFPACK suits meshes; KLU suits chains, trees and circuits, whose factors stay sparse.

    Attributes
    ----------
    report : LUReport
        What was done.

    Raises
    ------
    InputError
        If `A` is not square.
    SingularMatrixError
        If `A` is singular; `index` is the row.
    NonFiniteError
        If `A` holds NaN or infinity.
    MemoryError
        If there is too little memory; the object can be used again.

    References
    ----------
    Davis, "Algorithm 832: UMFPACK V4.3, an unsymmetric-pattern multifrontal method", ACM
    Transactions on Mathematical Software 30 (2004) 196. Davis, Palamadai Natarajan, "Algorithm 907:
    KLU, a direct sparse solver for circuit simulation problems", the same 37 (2010) 36.

    Examples
    --------
    >>> from substep.linalg import LU
    >>> LU([[0.0, 2.0], [1.0, 0.0]]).solve([2.0, 3.0])
    array([3., 1.])
    """

    def __init__(self, A: Any, *, kind: str = "automatic") -> None:
        self._kind = check_choice("kind", kind, ("automatic", "umfpack", "klu"))
        columns = _columns(A)
        _check_finite(columns)
        self._take(columns)

    def _analyse(self, matrix: _Columns) -> Any:
        is_complex = matrix.values.dtype.kind == "c"
        factor = _core.ComplexLUFactor if is_complex else _core.LUFactor
        return factor(matrix.start, matrix.row, self._kind)

    def factor(self, A: Any) -> LUReport:
        """Factorize another matrix; the analysis is kept where the pattern is the same.

        Parameters
        ----------
        A : sparse matrix, tuple or (n, n) array_like
            The matrix.

        Returns
        -------
        LUReport
            Also in `report`.

        Raises
        ------
        InputError
            If `A` is not square.
        SingularMatrixError
            If `A` is singular; `index` is the row.
        NonFiniteError
            If `A` holds NaN or infinity.

        Examples
        --------
        >>> from substep.linalg import LU
        >>> LU([[1.0, 2.0], [3.0, 4.0]]).factor([[4.0, 3.0], [2.0, 1.0]]).analyses
        1
        """
        columns = _columns(A)
        _check_finite(columns)
        self._take(columns)
        return self.report

    def solve(self, b: ArrayLike, *, transpose: bool = False) -> NDArray[Any]:
        """Solve A x = b, or A^T x = b.

        Parameters
        ----------
        b : (n,) or (n, k) array_like
            Right-hand sides; complex ones need a complex matrix.
        transpose : bool
            Solve with the transpose (without conjugation).

        Returns
        -------
        ndarray
            Of the shape of `b`.

        Raises
        ------
        NonFiniteError
            If `b` holds NaN or infinity, or the solution would.

        Examples
        --------
        >>> from substep.linalg import LU
        >>> LU([[1.0, 1.0], [0.0, 1.0]]).solve([1.0, 1.0], transpose=True)
        array([1., 0.])
        """
        is_complex = self._matrix.values.dtype.kind == "c"
        right = _right_sides(b, self._matrix.n, complex_ok=is_complex)
        if is_complex:
            right = right.astype(np.complex128)
        return _solution(self._native.solve(right, check_flag("transpose", transpose)))

    @property
    def report(self) -> LUReport:
        """What was done."""
        entries = self._native.report()
        entries["analyses"] = self._analyses
        entries["factorizations"] = self._factorizations
        return LUReport(**entries)


@dataclass(frozen=True)
class KrylovResult:
    """The answer of `cg` or `bicgstab`, and how it was found.

    Attributes
    ----------
    x : (n,) ndarray
        The answer.
    converged : bool
        Whether the stop rule was met.
    iterations : int
        Products with A, for BiCGSTAB pairs of them.
    residuals : tuple of float
        |b - A x|_2 before and after each iteration, as the recurrence has it.
    remedy : str
        What to try where it did not converge.
    """

    x: NDArray[Any]
    converged: bool
    iterations: int
    residuals: tuple[float, ...]
    remedy: str


def _operator(name: str, function: Callable[..., Any], n: int, dtype: Any) -> Callable[..., Any]:
    def product(x: NDArray[Any]) -> NDArray[Any]:
        y = check_array(name, function(x), (n,), complex_ok=dtype is np.complex128, finite=False)
        return y.astype(dtype, copy=False)

    return product


def _solve(
    symmetric: bool,
    A: Any,
    b: ArrayLike,
    x0: ArrayLike | None,
    preconditioner: Any,
    rtol: float,
    atol: float,
    max_iterations: int | None,
    threads: int | None,
) -> KrylovResult:
    method = "cg" if symmetric else "bicgstab"
    columns = None if callable(A) else _symmetric(A) if symmetric else _columns(A)
    n = len(np.atleast_1d(np.asarray(b))) if columns is None else columns.n
    right = _vector("b", b, n, complex_ok=not symmetric)
    guess = check_array("x0", np.zeros(n) if x0 is None else x0, (n,), complex_ok=not symmetric)
    parts = [right, guess, *([] if columns is None else [columns.values])]
    dtype: Any = np.complex128 if any(p.dtype.kind == "c" for p in parts) else np.float64
    native: Any
    if columns is None:
        native = _operator("A(x)", A, n, dtype)
    else:
        _check_finite(columns)
        native = (columns.start, columns.row, columns.values.astype(dtype, copy=False))
    if callable(preconditioner):
        chosen: Any = _operator("preconditioner(r)", preconditioner, n, dtype)
    else:
        names = ("none", "diagonal", "incomplete")
        default = "none" if columns is None else "diagonal"
        chosen = (
            default
            if preconditioner is None
            else check_choice("preconditioner", preconditioner, names)
        )
        if columns is None and chosen != "none":
            raise InputError(f"preconditioner: {chosen!r} needs the entries of A; pass a callable")
    x, converged, iterations, residuals, remedy = _core.krylov(
        symmetric,
        native,
        chosen,
        right.astype(dtype, copy=False),
        guess.astype(dtype, copy=False),
        check_real("rtol", rtol, nonnegative=True),
        check_real("atol", atol, nonnegative=True),
        0
        if max_iterations is None
        else check_integer("max_iterations", max_iterations, minimum=1, maximum=2**31 - 1),
        0 if threads is None else check_integer("threads", threads, minimum=1, maximum=1024),
    )
    result = KrylovResult(x, converged, iterations, tuple(residuals), remedy)
    if not converged:
        raise ConvergenceError(
            f"{method}: residual {residuals[-1]:.3g} after {iterations} iterations; {remedy}",
            residuals=residuals,
            result=result,
        )
    return result


def cg(
    A: Any,
    b: ArrayLike,
    *,
    x0: ArrayLike | None = None,
    preconditioner: str | Callable[..., Any] | None = None,
    rtol: float = 1e-8,
    atol: float = 0.0,
    max_iterations: int | None = None,
    threads: int | None = None,
) -> KrylovResult:
    """Solve A x = b for symmetric positive definite A by conjugate gradients.

    Parameters
    ----------
    A : sparse matrix, tuple, (n, n) array_like, or callable
        The matrix (see the module), or `A(x)`, which returns the product.
    b : (n,) array_like
        Right-hand side.
    x0 : (n,) array_like, optional
        First guess; zero by default.
    preconditioner : {"none", "diagonal", "incomplete"} or callable, optional
        The diagonal of A by default; incomplete Cholesky IC(0); or `M(r)`, which returns M^-1 r.
    rtol, atol : float
        Stops at |b - A x|_2 <= max(rtol |b|_2, atol).
    max_iterations : int, optional
        Twice the number of unknowns by default, at least 100.
    threads : int, optional
        Threads of this call; the result does not depend on it.

    Returns
    -------
    KrylovResult
        The answer and its history.

    Raises
    ------
    ConvergenceError
        If the stop rule is not met; `residuals` is the history, `result` the last iterate.
    InputError
        If `A` is not square or not symmetric.
    NonFiniteError
        If a number is or becomes NaN or infinite.

    References
    ----------
    Saad, "Iterative Methods for Sparse Linear Systems", 2nd ed., SIAM 2003, algorithm 9.1.

    Examples
    --------
    >>> import numpy as np
    >>> from substep.linalg import cg
    >>> chain = 2.0 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1)
    >>> cg(chain, [1.0, 0.0, 0.0, 1.0]).x.round(9)
    array([1., 1., 1., 1.])
    """
    return _solve(True, A, b, x0, preconditioner, rtol, atol, max_iterations, threads)


def bicgstab(
    A: Any,
    b: ArrayLike,
    *,
    x0: ArrayLike | None = None,
    preconditioner: str | Callable[..., Any] | None = None,
    rtol: float = 1e-8,
    atol: float = 0.0,
    max_iterations: int | None = None,
    threads: int | None = None,
) -> KrylovResult:
    """Solve A x = b for square A, real or complex, by BiCGSTAB.

    Parameters
    ----------
    A : sparse matrix, tuple, (n, n) array_like, or callable
        The matrix (see the module), or `A(x)`, which returns the product.
    b : (n,) array_like
        Right-hand side.
    x0 : (n,) array_like, optional
        First guess; zero by default.
    preconditioner : {"none", "diagonal", "incomplete"} or callable, optional
        The diagonal of A by default; incomplete LU, ILU(0); or `M(r)`, which returns M^-1 r.
    rtol, atol : float
        Stops at |b - A x|_2 <= max(rtol |b|_2, atol).
    max_iterations : int, optional
        Twice the number of unknowns by default, at least 100.
    threads : int, optional
        Threads of this call; the result does not depend on it.

    Returns
    -------
    KrylovResult
        The answer and its history.

    Raises
    ------
    ConvergenceError
        If the stop rule is not met; `residuals` is the history, `result` the last iterate.
    InputError
        If `A` is not square.
    NonFiniteError
        If a number is or becomes NaN or infinite.

    References
    ----------
    van der Vorst, "Bi-CGSTAB: a fast and smoothly converging variant of Bi-CG for the solution of
    nonsymmetric linear systems", SIAM J. Sci. Stat. Comput. 13 (1992) 631.

    Examples
    --------
    >>> from substep.linalg import bicgstab
    >>> bicgstab([[2.0, 1.0], [0.0, 1.0]], [3.0, 1.0]).x.round(9)
    array([1., 1.])
    """
    return _solve(False, A, b, x0, preconditioner, rtol, atol, max_iterations, threads)
