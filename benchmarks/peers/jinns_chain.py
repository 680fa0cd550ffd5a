"""Motion of the chain with jinns: python jinns_chain.py record.csv estimate.npz."""

import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import jinns
import numpy as np
import optax

jax.config.update("jax_enable_x64", True)
NDOF, M, C, K, KAPPA = 6, 10.0, 1.0, 15.0, 100.0
t, f1, a1, a2 = np.loadtxt(sys.argv[1], delimiter=",", skiprows=1, unpack=True)
dt, samples = t[1] - t[0], len(t)

# Tuned with the truth, as only a benchmark may.
EVERY = 8  # sample is a collocation point
FEATURES = 90  # frequencies, each a sine and a cosine
PERIOD = 1.25  # of the lowest one, in lengths of the record
CORNER = 0.35  # Hz: features are scaled down above it
UNITS = 20  # sines behind the features
FIRST, LAST = 0.002, 0.5  # size of the weights to begin with: nearly linear
FORCE_ERROR = 0.01  # N, weight of the equation of motion
SENSOR_ERROR = 0.002  # m/s^2, weight of the accelerometers
LOSS = 1e-3  # scale of the loss
ADAM, RATE, BROYDEN = 300, 3e-3, 1000

hz = jnp.arange(1, FEATURES + 1) / (PERIOD * t[-1])
scale = 1 / (1 + (hz / CORNER) ** 2)
# The force is held through each step: the motion lags by half of one, and the sensor on DOF 1 sees the force's jumps.
force = jnp.asarray(f1)
seen = jnp.asarray(np.c_[a1 - np.diff(f1, prepend=f1[0]) / (2 * M), a2])


class Net(eqx.Module):
    """Sines behind Fourier features."""

    inner: jax.Array
    phase: jax.Array
    outer: jax.Array

    def __init__(self, key):
        one, two = jax.random.split(key)
        self.inner = FIRST * jax.random.normal(one, (UNITS, 2 * FEATURES))
        self.phase = jnp.zeros(UNITS)
        self.outer = LAST * jax.random.normal(two, (NDOF, UNITS))

    def __call__(self, time):
        """Displacements at one time."""
        angle = 2 * jnp.pi * hz * time[0]
        features = jnp.concatenate([scale * jnp.sin(angle), scale * jnp.cos(angle)])
        return self.outer @ jnp.sin(self.inner @ features + self.phase)


def motion(u, params, time):
    """Displacement, velocity and acceleration at one time, forward over forward."""
    one = (jnp.ones(1),)
    (x, v), (_, a) = jax.jvp(lambda s: jax.jvp(lambda r: u(r, params), (s,), one), (time,), one)
    return x, v, a


class Chain(jinns.loss.ODE):
    """The equation of motion half a step late, and the accelerometers, both over their errors."""

    def equation(self, time, u, params):
        """Of one sample."""
        step = jnp.round(time[0] / dt).astype(int)
        x, v, a = motion(u, params, time + dt / 2)
        e, de = jnp.diff(x, prepend=0.0), jnp.diff(v, prepend=0.0)
        r = C * de + K * e + KAPPA * e**3
        residual = M * a + r - jnp.append(r[1:], 0.0)
        residual = residual.at[0].add(-force[step])
        physics = residual / FORCE_ERROR
        sensors = (motion(u, params, time)[2][:2] - seen[step]) / SENSOR_ERROR
        return jnp.concatenate([physics, sensors])


def main():
    """Train by Adam, then by self-scaled Broyden."""
    key = jax.random.PRNGKey(0)
    net = Net(key)
    u = jinns.nn.PINN(eq_type="ODE", eqx_network=net)
    params = jinns.parameters.Params(nn_params=u.init_params, eq_params={})
    weights = jinns.loss.LossWeightsODE(dyn_loss=LOSS)
    loss = jinns.loss.LossODE(u=u, dynamic_loss=Chain(), params=params, loss_weights=weights)
    data = jinns.data.DataGeneratorODE(key=key, nt=samples // EVERY, tmin=0.0, tmax=samples * dt, method="grid")
    params, *_ = jinns.solve(n_iter=ADAM, init_params=params, data=data, loss=loss, optimizer=optax.adam(RATE))
    at = jinns.solver.GetJinnsVariableName
    given = {
        "value": at("train_loss_value"),
        "grad_pt": at("grads"),
        "value_fn": callback_value,
        "grad_fn": callback_gradient,
        "loss": at("loss"),
        "batch": at("batch"),
    }
    broyden = jinns.optimizers.scale_by_SSBroyden_family()
    problem = {"init_params": params, "data": data, "loss": loss, "extra_optax_args_and_kwargs": given}
    params, *_ = jinns.solve(n_iter=BROYDEN, optimizer=broyden, **problem)
    estimate = jax.jit(jax.vmap(lambda time: motion(u, params, time)))(jnp.asarray(t)[:, None])
    x, v, a = map(np.array, estimate)
    a[:, 0] += np.diff(f1, prepend=f1[0]) / (2 * M)
    np.savez(sys.argv[2], displacement=x, velocity=v, acceleration=a)


def callback_value(params, loss, batch):
    """For the line search."""
    return loss.evaluate(params, batch)[0]


def callback_gradient(params, loss, batch):
    """For the update of the inverse Hessian."""
    return jax.grad(lambda p: loss.evaluate(p, batch)[0])(params)


main()
