"""Programs that several tests of `aerotube.sos` share."""

import numpy as np

from aerotube import sos


def maximum_program(domain, degree, weights=()):
    """Min rho with rho - f >= 0 on the domain: an upper bound of the maximum of f."""
    program = sos.Program()
    program.scalar("rho")
    program.sos("bound", domain, degree, weights)
    return program.compile()


def maximum_data(structure, function):
    values = function(structure.nodes("bound"))
    return structure.data(objective=[1.0], constraints={"bound": (-values, np.ones((*values.shape[-1:], 1)))})


def tube_program(states=4, inputs=2, degree=4, extremes=2):
    """A mean-square tube: forms N and S, a law K, one constraint for each extreme of a parameter."""
    program = sos.Program()
    program.symmetric("N", states)
    program.symmetric("S", states)
    program.matrix("K", (inputs, states))
    for k in range(extremes):
        program.sos(f"tube/{k}", sos.Sphere(states), degree)
    program.lmi("law", states + inputs)
    for i in range(inputs):
        program.norm(f"limit/{i}", states)
    return program.compile()


def tube_data(structure, seed, limit=0.5):
    """Random but lifelike numbers: a linear map near the identity with quadratic terms, orthonormal inputs."""
    rng = np.random.default_rng(seed)
    N, S, K = (structure.variable(name) for name in "NSK")
    inputs, n = K.shape
    constraints = {}
    left, right = (np.linalg.qr(rng.standard_normal((n, n)))[0] for _ in range(2))
    linear = left * np.linspace(0.3, 1.05, n) @ right
    outputs = np.linalg.qr(rng.standard_normal((n, inputs)))[0]
    quadratic = 0.1 * rng.standard_normal((n, n, n))
    change = 0.05 * rng.standard_normal((n, n))
    names = [c.name for c in structure.constraints if c.kind == "sos"]
    for name, sigma in zip(names, np.linspace(-1.0, 1.0, len(names)), strict=True):
        z = structure.nodes(name)
        r = z @ (linear + sigma * change).T + np.einsum("ijk,uj,uk->ui", quadratic, z, z) + 0.02 * sigma * outputs[:, 0]
        C = np.zeros((len(z), structure.size))
        for i in range(n):
            for j in range(n):
                C[:, N[i, j]] += z[:, i] * z[:, j]
        for i in range(inputs):
            for j in range(n):
                C[:, K[i, j]] -= 2.0 * (r @ outputs)[:, i] * z[:, j]
        constraints[name] = (-np.sum(r * r, axis=1), C)
    F0 = np.zeros((n + inputs, n + inputs))
    F0[n:, n:] = np.eye(inputs)
    F = np.zeros((structure.size, n + inputs, n + inputs))
    for i in range(n):
        for j in range(n):
            F[S[i, j], i, j] = 1.0
    for i in range(inputs):
        for j in range(n):
            F[K[i, j], n + i, j] = F[K[i, j], j, n + i] = 1.0
    constraints["law"] = (F0, F)
    for i in range(inputs):
        A = np.zeros((n, structure.size))
        A[np.arange(n), K[i]] = 1.0
        constraints[f"limit/{i}"] = (A, np.zeros(n), np.zeros(structure.size), limit)
    objective = np.zeros(structure.size)
    for i in range(n):
        objective[N[i, i]] += 1.0
        objective[S[i, i]] += 2.0
    return structure.data(objective=objective, constraints=constraints)
