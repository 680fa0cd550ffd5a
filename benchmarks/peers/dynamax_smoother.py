"""Motion of the chain with dynamax's extended Kalman smoother: python dynamax_smoother.py record.csv estimate.npz."""

import sys

import jax
import jax.numpy as jnp
import numpy as np
from dynamax.nonlinear_gaussian_ssm import ParamsNLGSSM, extended_kalman_smoother

jax.config.update("jax_enable_x64", True)
NDOF, M, C, K, KAPPA = 6, 10.0, 1.0, 15.0, 100.0
t, f1, a1, a2 = np.loadtxt(sys.argv[1], delimiter=",", skiprows=1, unpack=True)
dt = t[1] - t[0]

# Tuned with the truth, as only a benchmark may.
LOAD_CELL_NOISE = 0.01  # N: the force on mass 1 is off by it, anew in every step
MODEL_NOISE = 1e-5  # N, likewise of the other masses
SENSOR_NOISE = [6e-4, 4e-4]  # m/s^2
START = 1e-6  # m, m/s: the structure begins at rest

disturbance = jnp.array([0.0] * NDOF + [LOAD_CELL_NOISE] + [MODEL_NOISE] * (NDOF - 1))


def acceleration(state, force):
    """m/s^2, of every mass, from displacements and velocities."""
    e, de = jnp.diff(state[:NDOF], prepend=0.0), jnp.diff(state[NDOF:], prepend=0.0)
    r = C * de + K * e + KAPPA * e**3
    return (jnp.append(r[1:], 0.0) - r).at[0].add(force[0]) / M


def rate(state, force):
    """Of displacements and velocities."""
    return jnp.concatenate([state[NDOF:], acceleration(state, force)])


def step(state, force):
    """Runge-Kutta, the force held."""
    one = rate(state, force)
    two = rate(state + dt / 2 * one, force)
    three = rate(state + dt / 2 * two, force)
    four = rate(state + dt * three, force)
    return state + dt / 6 * (one + 2 * two + 2 * three + four)


model = ParamsNLGSSM(
    initial_mean=jnp.zeros(2 * NDOF),
    initial_covariance=START**2 * jnp.eye(2 * NDOF),
    dynamics_function=step,
    dynamics_covariance=jnp.diag((disturbance * dt / M) ** 2 + 1e-20),
    emission_function=lambda state, force: acceleration(state, force)[:2],
    emission_covariance=jnp.diag(jnp.array(SENSOR_NOISE) ** 2),
)
forces = jnp.asarray(f1)[:, None]
smoothed = extended_kalman_smoother(model, jnp.column_stack([a1, a2]), inputs=forces).smoothed_means
found = {"displacement": smoothed[:, :NDOF], "velocity": smoothed[:, NDOF:]}
np.savez(sys.argv[2], **found, acceleration=jax.vmap(acceleration)(smoothed, forces))
