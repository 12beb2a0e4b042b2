"""The cloth of bench/pbd.py in Taichi: N SUBSTEPS FRAMES THREADS, prints the time of a frame.

Colours and layout as a user of Taichi would write them: one kernel for each of the twelve colours,
which come from the grid.
"""

import json
import sys
import time

import taichi as ti

n, substeps, frames, threads = map(int, sys.argv[1:5])
ti.init(arch=ti.cpu, cpu_max_num_threads=threads, default_fp=ti.f32, offline_cache=False)
x, old, v = (ti.Vector.field(3, ti.f32, (n, n)) for _ in range(3))
w = ti.field(ti.f32, (n, n))
dx, h = 1.0 / (n - 1), 1.0 / 60 / substeps


@ti.kernel
def start():
    for a, b in x:
        x[a, b] = [b * dx, 0.0, a * dx]
        v[a, b] = [0.0, 0.0, 0.0]
        w[a, b] = n * n / 0.3
    w[0, 0] = 0.0
    w[0, n - 1] = 0.0


@ti.kernel
def predict():
    for i in ti.grouped(x):
        old[i] = x[i]
        if w[i] > 0:
            v[i] += ti.Vector([0.0, -9.81 * h, 0.0])
            x[i] += h * v[i]


@ti.func
def project(i, j, rest):
    d = x[i] - x[j]
    length, weight = d.norm(), w[i] + w[j]
    if weight > 0 and length > 0:
        s = (rest - length) / (weight * length)
        x[i] += w[i] * s * d
        x[j] -= w[j] * s * d


@ti.kernel
def sweep(da: ti.i32, db: ti.i32, shift: ti.i32, group: ti.i32, along: ti.i32, rest: ti.f32):
    # Pairs (a, b), (a + da, b + db) with (row or column // group) of one parity.
    for a, b in ti.ndrange(n - da, n - ti.abs(db)):
        row = a if along == 0 else b
        if row // group % 2 == shift:
            first = b if db >= 0 else b - db
            project(ti.Vector([a, first]), ti.Vector([a + da, first + db]), rest)


@ti.kernel
def finish():
    for i in ti.grouped(x):
        v[i] = (x[i] - old[i]) / h


def frame():
    for _ in range(substeps):
        predict()
        for shift in (0, 1):
            sweep(0, 1, shift, 1, 1, dx)
            sweep(1, 0, shift, 1, 0, dx)
            sweep(1, 1, shift, 1, 0, dx * 2**0.5)
            sweep(1, -1, shift, 1, 0, dx * 2**0.5)
            sweep(0, 2, shift, 2, 1, 2 * dx)
            sweep(2, 0, shift, 2, 0, 2 * dx)
        finish()
    ti.sync()


start()
frame()
times = []
for _ in range(frames):
    begin = time.perf_counter()
    frame()
    times.append(time.perf_counter() - begin)
print(json.dumps({"seconds": min(times)}))
