"""substep.linalg: residuals, every kind of bad input, threads, fork, little memory."""

import concurrent.futures
import os
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import scipy.sparse as sp
import substep
from substep import _core
from substep.linalg import LU, Cholesky, bicgstab, cg

GPL = _core.library_versions()["gpl"]
CHOLESKY_KINDS = ["simplicial", "supernodal"] if GPL else ["simplicial"]
LU_KINDS = ["umfpack", "klu"] if GPL else ["klu"]


def laplacian(side, dimensions=2, shift=0.01):
    """The 5- or 7-point Laplacian plus a shift."""
    chain = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(side, side))
    eye = sp.eye_array(side)
    total = chain
    for _ in range(dimensions - 1):
        total = sp.kron(total, eye) + sp.kron(sp.eye_array(total.shape[0]), chain)
    return sp.csc_array(total + shift * sp.eye_array(total.shape[0]))


def unsymmetric(side):
    """Diffusion with a wind across the mesh."""
    wind = sp.diags_array([-0.3, 0.3], offsets=[-1, 1], shape=(side, side))
    return sp.csc_array(laplacian(side) + sp.kron(wind, sp.eye_array(side)))


def relative_residual(A, x, b):
    return np.abs(A @ x - b).max() / (np.abs(A.data).max() * np.abs(x).max())


@pytest.fixture
def b():
    return np.random.default_rng(1).standard_normal(900)


@pytest.mark.parametrize("kind", CHOLESKY_KINDS)
@pytest.mark.parametrize("ordering", ["amd", "metis", "natural"])
def test_cholesky_solves(kind, ordering, b):
    A = laplacian(30)
    cholesky = Cholesky(A, kind=kind, ordering=ordering)
    report = cholesky.report
    assert report.positive_definite and report.column is None
    assert (report.kind, report.ordering) == (kind, ordering)
    assert relative_residual(A, cholesky.solve(b), b) < 1e-13
    many = np.stack([b, 2 * b, b[::-1]], axis=1)
    assert np.allclose(cholesky.solve(many)[:, 2], cholesky.solve(b[::-1]), rtol=0, atol=1e-13)
    assert relative_residual(A, cholesky.solve(many), many) < 1e-13


@pytest.mark.parametrize("kind", LU_KINDS)
@pytest.mark.parametrize("factor", [1.0, 1.0 + 0.5j])
def test_lu_solves(kind, factor, b):
    A = unsymmetric(30) * factor
    lu = LU(A, kind=kind)
    assert lu.report.kind == kind and 0 < lu.report.rcond < 1
    assert relative_residual(A, lu.solve(b), b) < 1e-12
    assert relative_residual(A.T, lu.solve(b, transpose=True), b) < 1e-12


@pytest.mark.skipif(not GPL, reason="this build has KLU only")
def test_lu_takes_klu_for_chains_and_umfpack_for_meshes():
    assert LU(unsymmetric(8)).report.kind == "klu"
    assert LU(laplacian(500, dimensions=1)).report.kind == "klu"
    assert LU(laplacian(12, dimensions=3)).report.kind == "umfpack"
    assert LU(np.zeros((0, 0))).report.kind == "klu"


@pytest.mark.skipif(GPL, reason="this build has all parts")
def test_what_this_build_lacks_is_said():
    with pytest.raises(substep.InputError, match="no UMFPACK"):
        LU(unsymmetric(8), kind="umfpack")
    with pytest.raises(substep.InputError, match="no supernodal"):
        Cholesky(laplacian(8), kind="supernodal")


def test_a_block_of_coordinates_is_ordered_by_vertices(b):
    A = sp.csc_array(sp.kron(laplacian(20), sp.eye_array(3)) + 0.1 * sp.eye_array(1200))
    right = np.resize(b, 1200)
    x = Cholesky(A, block=3).solve(right)
    assert relative_residual(A, x, right) < 1e-13


@pytest.mark.parametrize("solver", [Cholesky, LU])
def test_analysis_is_kept_for_the_same_pattern(solver, b):
    A = laplacian(30)
    factor = solver(A)
    assert factor.factor(2 * A).analyses == 1
    x = factor.solve(b)
    assert np.array_equal(x, solver(2 * A).solve(b))
    assert factor.factor(laplacian(10)).analyses == 2
    assert factor.report.factorizations == 3
    assert factor.solve(b[:100]).shape == (100,)


def test_every_form_of_a_matrix_gives_the_same(b):
    A = laplacian(30)
    x = Cholesky(A).solve(b)
    shuffled = sp.csc_array(A)
    for j in range(A.shape[1]):  # rows in falling order
        part = slice(A.indptr[j], A.indptr[j + 1])
        shuffled.indices[part] = shuffled.indices[part][::-1].copy()
        shuffled.data[part] = shuffled.data[part][::-1].copy()
    halves = sp.coo_array(  # each entry in two halves
        (np.repeat(A.tocoo().data / 2, 2), [np.repeat(c, 2) for c in A.tocoo().coords]), A.shape
    )
    twice = (np.append(A.data, 1.0), np.append(A.indices, 899), np.append(A.indptr[:-1], A.nnz + 1))
    for form in (
        A.tocsr(),
        A.tocoo(),
        A.toarray(),
        shuffled,
        halves,
        (A.data, A.indices, A.indptr),
    ):
        assert np.array_equal(Cholesky(form).solve(b), x)
    assert Cholesky(twice).report.positive_definite


def test_indefinite_matrix_is_an_answer(b):
    for kind in CHOLESKY_KINDS:
        cholesky = Cholesky(laplacian(30, shift=-3.0), kind=kind)
        assert not cholesky.report.positive_definite
        assert 0 <= cholesky.report.column < 900
        with pytest.raises(substep.SingularMatrixError, match="positive definite") as caught:
            cholesky.solve(b)
        assert caught.value.index == cholesky.report.column
        assert cholesky.factor(laplacian(30)).positive_definite
        cholesky.solve(b)


def test_solutions_beyond_float64_are_none():
    for factors in (Cholesky(1e-300 * np.eye(3)), LU(1e-300 * np.eye(3))):
        with pytest.raises(substep.NonFiniteError, match="row 1") as caught:
            factors.solve([1.0, 1e300, 1.0])
        assert caught.value.index == 1


def test_sparse_matrices_whose_indices_are_wrong():
    code = """
import numpy as np, scipy.sparse as sp, substep
def spoiled(form, **parts):
    A = form(np.eye(4))
    for name, values in parts.items():
        setattr(A, name, np.array(values, np.int32))
    return A
far = [0, 10**7, 2, 3]
uses = [
    *(lambda A, f=f: f(A, np.ones(4)) for f in (substep.linalg.cg, substep.linalg.bicgstab)),
    *(lambda A, f=f: f(A) for f in (substep.linalg.Cholesky, substep.linalg.LU)),
    lambda A: substep.solve_ivp(lambda t, y: -y, (0, 1), np.ones(4), "Radau", jac=A),
    lambda A: substep.solve_ivp(lambda t, y: -y, (0, 1), np.ones(4), "Radau", jac_sparsity=A),
]
for form in (sp.csr_matrix, sp.csc_matrix, sp.csr_array):
    for A in (spoiled(form, indices=far), spoiled(form, indptr=[0, 10**7, 10**7, 4, 4])):
        for use in uses:
            try:
                use(A)
            except substep.InputError:
                continue
            print("accepted", form, use)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr


@pytest.mark.parametrize("kind", LU_KINDS)
def test_singular_matrix_names_its_row(kind):
    A = unsymmetric(10).tolil()
    A[37] = 0.0
    with pytest.raises(substep.SingularMatrixError) as caught:
        LU(A, kind=kind)
    assert caught.value.index == 37
    with pytest.raises(substep.SingularMatrixError) as caught:
        LU(np.zeros((3, 3)), kind=kind)
    assert caught.value.index == 0
    with pytest.raises(substep.SingularMatrixError):
        LU(np.ones((5, 5)), kind=kind)
    lu = LU(unsymmetric(10), kind=kind)
    report, x = lu.report, lu.solve(np.ones(100))
    for wrong in (0 * unsymmetric(10), np.ones((5, 5))):
        with pytest.raises(substep.SingularMatrixError):
            lu.factor(wrong)
        assert lu.report == report
        assert np.array_equal(lu.solve(np.ones(100)), x)


SOLVES = {
    "Cholesky": lambda A, b: Cholesky(A).solve(b),
    "LU": lambda A, b: LU(A).solve(b),
    "cg": lambda A, b: cg(A, b).x,
    "bicgstab": lambda A, b: bicgstab(A, b).x,
}
each_solver = pytest.mark.parametrize("solve", SOLVES.values(), ids=SOLVES)


@each_solver
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused_with_its_place(solve, value):
    A = laplacian(10).toarray()
    b = np.ones(100)
    A[7, 7] = value
    with pytest.raises(substep.NonFiniteError, match=r"A\[7, 7\]"):
        solve(A, b)
    A[7, 7] = 4.0
    b[12] = value
    with pytest.raises(substep.NonFiniteError, match="12") as caught:
        solve(A, b)
    assert caught.value.index == 12


@each_solver
def test_wrong_shapes_and_types(solve):
    A = laplacian(10)
    b = np.ones(100)
    with pytest.raises(substep.InputError, match="square"):
        solve(np.ones((3, 4)), np.ones(3))
    with pytest.raises(substep.InputError, match="square"):
        solve(sp.csc_array(np.ones((3, 4))), np.ones(3))
    with pytest.raises(substep.InputError, match="b: expected shape"):
        solve(A, np.ones(99))
    with pytest.raises(TypeError, match="A"):
        solve("matrix", b)
    with pytest.raises(TypeError, match="b"):
        solve(A, ["a"] * 100)
    for wrong in (
        (A.data, A.indices[:-1], A.indptr),
        (A.data[:-1], A.indices, A.indptr),
        (A.data, A.indices + 1, A.indptr),
        (A.data, A.indices - 1, A.indptr),
        (A.data, A.indices, A.indptr[::-1]),
        (A.data, A.indices, A.indptr[1:]),
        (A.data, A.indices, []),
    ):
        with pytest.raises(substep.InputError, match=r"A\."):
            solve(wrong, b)


@pytest.mark.parametrize("solve", [SOLVES["Cholesky"], SOLVES["cg"]])
def test_asymmetry_is_refused_with_its_place(solve):
    A = laplacian(10).toarray()
    A[3, 4] += 1e-3
    with pytest.raises(substep.InputError, match=r"A\[(3, 4|4, 3)\] is not A\[(3, 4|4, 3)\]"):
        solve(A, np.ones(100))
    A[3, 4] = A[4, 3] + 1e-14  # rounding
    assert np.isfinite(solve(A, np.ones(100))).all()
    with pytest.raises(TypeError, match="A: expected real"):
        solve(A * 1j, np.ones(100))


@each_solver
def test_small_matrices(solve):
    assert solve(np.zeros((0, 0)), np.zeros(0)).shape == (0,)
    assert solve([[4.0]], [8.0]) == [2.0]
    apart = np.kron(np.eye(3), [[2.0, -1.0], [-1.0, 2.0]])  # three islands
    assert np.allclose(apart @ solve(apart, np.arange(6.0)), np.arange(6.0), atol=1e-7)


def test_options_are_checked():
    A = laplacian(4)
    with pytest.raises(substep.InputError, match="ordering: expected one of automatic, amd"):
        Cholesky(A, ordering="nested")
    with pytest.raises(substep.InputError, match="block"):
        Cholesky(A, block=3)
    with pytest.raises(substep.InputError, match="kind"):
        LU(A, kind="qr")
    with pytest.raises(substep.InputError, match="preconditioner"):
        cg(A, np.ones(16), preconditioner="ilu")
    with pytest.raises(substep.InputError, match="needs the entries"):
        cg(lambda x: x, np.ones(16), preconditioner="diagonal")
    with pytest.raises(substep.InputError, match="max_iterations"):
        cg(A, np.ones(16), max_iterations=0)
    with pytest.raises(substep.InputError, match="x0"):
        cg(A, np.ones(16), x0=np.ones(15))


@pytest.mark.parametrize("preconditioner", ["none", "diagonal", "incomplete"])
def test_krylov_methods_converge(preconditioner, b):
    A = laplacian(30)
    result = cg(A, b, rtol=1e-12, preconditioner=preconditioner)
    assert result.converged and len(result.residuals) == result.iterations + 1
    assert np.linalg.norm(A @ result.x - b) < 2e-12 * np.linalg.norm(b)
    for scale in (1.0, 1.0 + 0.2j):
        A = unsymmetric(30) * scale
        result = bicgstab(A, b, rtol=1e-10, preconditioner=preconditioner)
        assert np.linalg.norm(A @ result.x - b) < 1e-9 * np.linalg.norm(b)


def test_matrix_free_operators(b):
    A = laplacian(30)
    diagonal = A.diagonal()
    whole = cg(A, b, threads=1)
    free = cg(lambda x: A @ x, b, preconditioner=lambda r: r / diagonal)
    assert abs(free.iterations - whole.iterations) <= 1
    assert np.allclose(free.x, whole.x, atol=1e-6)
    complex_product = unsymmetric(30) * (1 + 1j)
    result = bicgstab(lambda x: complex_product @ x, b.astype(complex))
    assert np.linalg.norm(complex_product @ result.x - b) < 1e-6
    with pytest.raises(ZeroDivisionError):
        cg(lambda x: 1 / 0, b)
    with pytest.raises(substep.InputError, match=r"A\(x\): expected shape"):
        cg(lambda x: x[:-1], b)
    with pytest.raises(substep.NonFiniteError):
        cg(lambda x: np.full(900, np.nan), b)


def test_first_guess(b):
    A = laplacian(30)
    x = cg(A, b, rtol=1e-12).x
    again = cg(A, b, x0=x, rtol=1e-10)
    assert again.iterations == 0 and np.array_equal(again.x, x)


def test_no_convergence_raises_with_the_history(b):
    with pytest.raises(substep.ConvergenceError, match="3 iterations") as caught:
        cg(laplacian(30), b, max_iterations=3)
    assert len(caught.value.residuals) == 4
    assert caught.value.result.iterations == 3 and not caught.value.result.converged
    with pytest.raises(substep.ConvergenceError, match="not positive definite"):
        cg(laplacian(30, shift=-3.0), b, preconditioner="none")


def test_same_bits_for_any_number_of_threads():
    A = laplacian(150)
    b = np.random.default_rng(2).standard_normal(150**2)
    wind = unsymmetric(150)
    answers = {
        threads: substep.state_hash(
            cg(A, b, threads=threads).x, bicgstab(wind, b, threads=threads).x
        )
        for threads in (1, 2, 3)
    }
    assert len(set(answers.values())) == 1


def test_factorizations_in_several_python_threads_have_the_bits_of_one():
    A = laplacian(14, dimensions=3)
    b = np.random.default_rng(3).standard_normal(14**3)

    def solved(_):
        return substep.state_hash(Cholesky(A).solve(b), LU(A).solve(b))

    alone = solved(0)
    with concurrent.futures.ThreadPoolExecutor(3) as pool:
        assert set(pool.map(solved, range(9))) == {alone}


def test_one_factor_may_serve_several_threads():
    A = laplacian(40)
    b = np.random.default_rng(4).standard_normal((1600, 8))
    for factor in (Cholesky(A), LU(A)):
        alone = [factor.solve(b[:, k]) for k in range(8)]
        with concurrent.futures.ThreadPoolExecutor(3) as pool:
            at_once = list(pool.map(lambda k, f=factor: f.solve(b[:, k]), range(8)))
        assert all(np.array_equal(x, y) for x, y in zip(alone, at_once, strict=True))


def run_python(code, **env):
    return subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, **env},
        capture_output=True,
        text=True,
        timeout=120,
    )


PROBLEM = """
import os, resource, sys
import numpy as np
import substep
from substep.linalg import LU, Cholesky
def laplacian(side):
    n = side**3
    i = np.arange(n)
    rows, cols, values = [i], [i], [np.full(n, 6.1)]
    for stride in (1, side, side**2):
        inside = i[(i // stride) % side < side - 1]
        for a, b in ((inside, inside + stride), (inside + stride, inside)):
            rows.append(a); cols.append(b); values.append(np.full(len(a), -1.0))
    rows, cols, values = map(np.concatenate, (rows, cols, values))
    order = np.lexsort((rows, cols))
    start = np.searchsorted(cols[order], np.arange(n + 1))
    return values[order], rows[order], start
"""


def test_a_child_after_fork_factorizes():
    # libgomp's threads do not survive fork(): a child that opened a parallel region would hang.
    code = (
        PROBLEM
        + """
A = laplacian(12)
b = np.ones(12**3)
here = Cholesky(A).solve(b), LU(A).solve(b)
child = os.fork()
if child == 0:
    there = Cholesky(A).solve(b), LU(A).solve(b)
    os._exit(0 if all(np.array_equal(x, y) for x, y in zip(here, there)) else 1)
print(os.waitpid(child, 0)[1])
"""
    )
    done = run_python(code)
    assert done.stdout == "0\n", done.stderr


@pytest.mark.skipif("libasan" in os.environ.get("LD_PRELOAD", ""), reason="ASan reserves terabytes")
@pytest.mark.parametrize("solver", ["Cholesky", "LU"])
def test_little_memory_raises_memory_error_and_can_go_on(solver):
    # L has some 300 MB.
    code = (
        PROBLEM
        + f"""
A, small = laplacian(52), laplacian(6)
solver = {solver}
solver(small)
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 120_000_000, -1))
try:
    solver(A)
except MemoryError:
    print("MemoryError")
x = solver(small).solve(np.ones(216))
print(np.isfinite(x).all())
"""
    )
    done = run_python(code)
    assert done.stdout == "MemoryError\nTrue\n", done.stderr


def test_blas_is_the_serial_openblas_and_ours_alone():
    versions = _core.library_versions()
    assert versions["blas"].startswith("OpenBLAS")
    assert versions["blas_is_serial"]
    assert versions["blas_is_reentrant"]
    assert len(os.listdir("/proc/self/task")) < 200
    done = run_python(
        PROBLEM
        + """
Cholesky(laplacian(12))
print(len(os.listdir("/proc/self/task")))
""",
        OMP_NUM_THREADS="4",
        OPENBLAS_NUM_THREADS="1",
    )
    assert done.stdout == "1\n", done.stdout + done.stderr


def test_kernels_of_blas_are_those_of_the_level():
    kernels = {"v3": "Haswell", "v4": "SkylakeX"}.get(_core.level, "")
    code = (
        "import os, substep; print(substep._core.library_versions()['blas'], "
        "'OPENBLAS_CORETYPE' in os.environ)"
    )
    done = run_python(code)
    assert kernels in done.stdout and done.stdout.endswith("False\n"), done.stdout + done.stderr
    done = run_python(code, OPENBLAS_CORETYPE="Nehalem")
    assert "kernels for Nehalem True\n" in done.stdout, done.stdout + done.stderr


@pytest.mark.parametrize("kind", [Cholesky, LU])
def test_a_second_thread_waits_for_the_factors(kind):
    class Slow:
        def __init__(self, native):
            self.native = native

        def factor(self, values):
            begun.set()
            time.sleep(0.05)
            self.native.factor(values)

        def __getattr__(self, name):
            return getattr(self.native, name)

    begun, factors = threading.Event(), kind(np.diag([1.0, 4.0]))
    factors._native = Slow(factors._native)
    thread = threading.Thread(target=factors.factor, args=(np.diag([4.0, 16.0]),))
    thread.start()
    begun.wait()
    assert factors.solve([4.0, 16.0]).tolist() == [1.0, 1.0]
    assert factors.report.factorizations == 2
    thread.join()
