"""How long may a step be? The spectrum of a damped spring chain in three stability regions."""

import numpy as np
from substep import stability

masses, stiffness, damping = 30, 900.0, 8.0
laplace = 2 * np.eye(masses) - np.eye(masses, k=1) - np.eye(masses, k=-1)
jacobian = np.block(
    [[np.zeros((masses, masses)), np.eye(masses)], [-stiffness * laplace, -damping * laplace]]
)
eigenvalues = np.linalg.eigvals(jacobian)

print(f"stiffness ratio {stability.stiffness_ratio(eigenvalues):.0f}")
for method in (*stability.one_step_methods(), *stability.second_order_methods()):
    print(f"{method:<18}largest stable step {stability.max_stable_step(method, eigenvalues):.5f} s")

step = stability.max_stable_step("rk4", eigenvalues)
axes = stability.plot(["euler", "heun", "rk4"], eigenvalues, step)
axes.set_title(f"A spring chain at h = {step:.4f} s")
axes.figure.savefig("stability_region.png", dpi=120)
print("wrote stability_region.png")
