"""df/dy and mass matrices as users give them, for the implicit methods of solve_ivp."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base.checks import as_array, check_array, check_sparse, describe
from ..base.pointers import RHS, find_address
from ..errors import InputError
from .rhs import pointer_parameters, unpack_args

Columns = tuple[NDArray[np.int32], NDArray[np.int32]]  # starts of the columns, rows
Matrix = tuple[Columns | None, NDArray[np.float64]]  # no columns: n * n values by columns


def make_jacobian(
    jac: Any,
    jac_sparsity: Any,
    system: _core.System,
    t0: float,
    y0: NDArray[Any],
    args: Any,
    check: bool,
) -> _core.Jacobian | None:
    """The native form of `jac` or of differences with `jac_sparsity`; None: the system's own."""
    complex_y = y0.dtype.kind == "c"
    pattern = None if jac_sparsity is None else _pattern(jac_sparsity, y0.size, complex_y)
    if jac is None:
        if check:
            _compare(_own(system, t0, y0), system, t0, y0)
        return None if pattern is None else _core.finite_differences(system, pattern)
    address, user_data = find_address("jac", jac, RHS)
    if address is not None:
        if complex_y:
            raise TypeError("jac: compiled functions have real values, y0 is complex")
        parameters = pointer_parameters(args) if args is not None else user_data
        return _core.PointerJacobian(address, y0.size, parameters, pattern)
    if not callable(jac):
        matrix = _convert(jac, y0.size, complex_y, finite=True)
        if check:
            _compare(matrix, system, t0, y0)
        return _core.ConstantJacobian(*matrix)
    function = _Function(jac, unpack_args(args), y0.size, complex_y, pattern)
    y = y0.copy()
    y.flags.writeable = False
    first = function(t0, y, finite=True)
    if check:
        _compare(first, system, t0, y0)
    return _core.PythonJacobian(function, first[0], y0.size, complex_y)


class _Function:
    """jac(t, y, *args) as a matrix whose pattern is the given one, or grows with what comes."""

    def __init__(
        self, jac: Any, args: tuple[Any, ...], size: int, complex_y: bool, pattern: Columns | None
    ) -> None:
        self.jac = jac
        self.args = args
        self.size = size
        self.complex_y = complex_y
        self.fixed = pattern is not None
        self.pattern = pattern

    def __call__(self, t: float, y: NDArray[Any], finite: bool = False) -> Matrix:
        value = self.jac(t, y, *self.args)
        columns, values = _convert(value, self.size, self.complex_y, finite=finite)
        if columns is None:
            return (None, values) if self.pattern is None else self._sampled(values)
        if self.pattern is None:
            self.pattern = columns
        elif not (
            np.array_equal(columns[0], self.pattern[0])
            and np.array_equal(columns[1], self.pattern[1])
        ):
            return self._spread(columns, values)
        return self.pattern, values

    def _sampled(self, full: NDArray[np.float64]) -> Matrix:
        """A full matrix where a pattern is known."""
        assert self.pattern is not None
        places = _places(self.pattern)
        rest = full.copy()
        rest[places] = 0.0
        self._refuse_outside(np.flatnonzero(rest))
        return self.pattern, full[places]

    def _spread(self, columns: Columns, values: NDArray[np.float64]) -> Matrix:
        """A matrix of another pattern."""
        assert self.pattern is not None
        places, known = _places(columns), _places(self.pattern)
        new = np.setdiff1d(places, known)
        if new.size:
            self._refuse_outside(new)
            known = np.union1d(known, new)
            self.pattern = _columns_of(known, columns[0].size - 1)
        result = np.zeros(known.size)
        result[np.searchsorted(known, places)] = values
        return self.pattern, result

    def _refuse_outside(self, places: NDArray[Any]) -> None:
        if self.fixed and places.size:
            assert self.pattern is not None
            j, i = divmod(int(places[0]), self.pattern[0].size - 1)
            raise InputError(f"jac: the entry [{i}, {j}] lies outside jac_sparsity")


def make_mass(mass: Any, size: int, complex_y: bool) -> _core.MassMatrix | None:
    """The native form of `mass`; a vector is a diagonal."""
    if mass is None:
        return None
    if not hasattr(mass, "tocsc") and as_array("mass", mass).ndim == 1:
        diagonal = check_array("mass", mass, (size,), complex_ok=complex_y)
        start = np.arange(size + 1, dtype=np.int32)
        if complex_y:
            return _core.MassMatrix(*_pairs(((start, start[:-1]), diagonal.astype(complex)), size))
        return _core.MassMatrix((start, start[:-1]), diagonal)
    return _core.MassMatrix(*_convert(mass, size, complex_y, finite=True, name="mass"))


def check_consistent(
    mass: Any, system: _core.System, t0: float, y0: NDArray[Any], rtol: Any, atol: Any
) -> None:
    """A singular M leaves algebraic equations, which y0 must satisfy to its tolerance."""
    null = _left_null_space(mass, y0.size)
    if null.shape[0] == 0:
        return
    y, f = _parts(y0), np.asarray(system.rhs(t0, _parts(y0)))
    residual = null @ _whole(f, y0)
    # What residuals become where y is off by its tolerance.
    scale = np.zeros(null.shape[0])
    rng = np.random.default_rng(0)
    width = np.broadcast_to(np.asarray(atol) + np.asarray(rtol) * np.abs(y0), y0.shape)
    for _ in range(3):
        there = y0 + width * rng.choice([-1.0, 1.0], y0.size)
        change = _whole(np.asarray(system.rhs(t0, _parts(there))), y0) - _whole(f, y0)
        scale = np.maximum(scale, np.abs(null @ change))
    bad = ~(np.abs(residual) <= 10 * scale + 1e-13 * np.abs(y).max())
    if bad.any():
        k = int(np.argmax(bad))
        row = int(np.argmax(np.abs(null[k])))
        raise InputError(
            f"y0: not consistent: the mass matrix is singular and leaves an algebraic equation, "
            f"about row {row}, with the residual {abs(residual[k]):.6g} at t = {t0}; it must be 0"
        )


def _left_null_space(mass: Any, size: int) -> NDArray[Any]:
    """Rows z with z M = 0. Of great sparse matrices only the rows without entries are found."""
    if not hasattr(mass, "tocsc"):
        array = np.asarray(mass)
        if array.ndim == 1:
            return np.eye(size)[array == 0]
    elif size <= 1000:
        array = mass.toarray()
    else:
        rows = np.flatnonzero(np.diff(mass.tocsr().indptr) == 0)
        from scipy.sparse import csr_matrix

        ones = np.ones(rows.size)
        return csr_matrix((ones, (np.arange(rows.size), rows)), shape=(rows.size, size))
    u, s, _ = np.linalg.svd(array)
    return np.asarray(u[:, s <= size * 2.2e-16 * s.max(initial=0.0)].conj().T)


def _own(system: _core.System, t0: float, y0: NDArray[Any]) -> Matrix:
    """The system's own Jacobian."""
    if not system.has_jacobian:
        raise InputError("check_jacobian: there is no Jacobian to check; give jac")
    value = system.jacobian(t0, y0)
    if isinstance(value, tuple):
        return (value[0], value[1]), value[2]
    return None, np.asarray(value).T.ravel()


def _convert(value: Any, size: int, complex_y: bool, *, finite: bool, name: str = "jac") -> Matrix:
    """A dense or sparse matrix of `size` rows by columns; for complex y, of (real, imaginary)."""
    if hasattr(value, "tocsc"):
        if value.shape != (size, size):
            raise InputError(f"{name}: expected shape ({size}, {size}), got {value.shape}")
        matrix = check_sparse(name, value).tocsc(copy=True)
        matrix.sum_duplicates()
        matrix.sort_indices()
        data = check_array(name, matrix.data, (None,), complex_ok=complex_y, finite=finite)
        columns = (matrix.indptr.astype(np.int32), matrix.indices.astype(np.int32))
        return _pairs((columns, data), size) if complex_y else (columns, data)
    if value is None or isinstance(value, str):
        raise TypeError(f"{name}: expected a matrix, got {describe(value)}")
    array = check_array(name, value, (size, size), complex_ok=complex_y, finite=finite)
    if not complex_y:
        return None, array.T.ravel()
    pairs = np.kron(array.real, np.eye(2)) + np.kron(array.imag, [[0.0, -1.0], [1.0, 0.0]])
    return None, pairs.T.ravel()


def _pairs(matrix: tuple[Columns, NDArray[Any]], size: int) -> Matrix:
    """Each complex entry a + i b becomes the square [[a, -b], [b, a]]."""
    (start, row), values = matrix
    column = np.repeat(np.arange(size), np.diff(start))
    places, parts = [], []
    for i, j, part in (
        (0, 0, values.real),
        (1, 0, values.imag),
        (0, 1, -values.imag),
        (1, 1, values.real),
    ):
        places.append((2 * column + j) * (2 * size) + 2 * row.astype(np.int64) + i)
        parts.append(part)
    place = np.concatenate(places)
    order = np.argsort(place)
    return _columns_of(place[order], 2 * size), np.concatenate(parts)[order].astype(float)


def _places(columns: Columns) -> NDArray[np.int64]:
    """Column * size + row of each entry."""
    start, row = columns
    size = start.size - 1
    return np.repeat(np.arange(size, dtype=np.int64), np.diff(start)) * size + row


def _columns_of(places: NDArray[np.int64], size: int) -> Columns:
    counts = np.bincount(places // size, minlength=size)
    start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
    return start, (places % size).astype(np.int32)


def _pattern(jac_sparsity: Any, size: int, complex_y: bool) -> Columns:
    """Where the given matrix is not zero, and the diagonal."""
    columns, values = _convert(jac_sparsity, size, False, finite=True, name="jac_sparsity")
    places = np.arange(size * size) if columns is None else _places(columns)
    places = places[values != 0]
    if complex_y:
        column, row = divmod(places, size)
        pairs = [(2 * column + j) * (2 * size) + 2 * row + i for i in (0, 1) for j in (0, 1)]
        return _columns_of(np.sort(np.concatenate(pairs)), 2 * size)
    return _columns_of(places, size)


def _parts(y: NDArray[Any]) -> NDArray[np.float64]:
    """Complex numbers as pairs of real ones."""
    return np.ascontiguousarray(y).view(np.float64)


def _whole(parts: NDArray[np.float64], y0: NDArray[Any]) -> NDArray[Any]:
    return parts.view(y0.dtype)


def _compare(matrix: Matrix, system: _core.System, t0: float, y0: NDArray[Any]) -> None:
    """InputError where a Jacobian is not what central differences say."""
    columns, values = matrix
    y = _parts(y0)
    n = y.size
    by_columns = np.zeros(n * n)
    by_columns[slice(None) if columns is None else _places(columns)] = values
    given = by_columns.reshape(n, n).T
    width = np.finfo(float).eps ** (1 / 3) * np.maximum(np.abs(y), 1e-3 * np.abs(y).max(initial=0))
    width = np.where(width > 0, width, 1e-6)
    wanted = np.empty((n, n))
    for j in range(n):
        step = width[j] * (np.arange(n) == j)
        difference = system.rhs(t0, y + step) - system.rhs(t0, y - step)
        wanted[:, j] = difference / (2 * width[j])
    size = np.maximum(np.abs(wanted), np.abs(given))
    allowed = 1e-4 * size + 1e-6 * np.abs(wanted).max(axis=1, keepdims=True)
    bad = ~(np.abs(given - wanted) <= allowed)
    if bad.any():
        i, j = divmod(int(np.argmax(bad)), n)
        raise InputError(
            f"jac[{i}, {j}]: expected about {wanted[i, j]:.6g} (central differences at "
            f"t = {t0}), got {given[i, j]:.6g}"
        )
