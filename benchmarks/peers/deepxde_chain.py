"""Motion of the chain with DeepXDE (PyTorch): python deepxde_chain.py record.csv estimate.npz."""

import os
import sys

os.environ["DDE_BACKEND"] = "pytorch"
import deepxde as dde
import numpy as np
import torch

dde.config.set_default_float("float64")
dde.config.set_random_seed(0)
NDOF, M, C, K, KAPPA = 6, 10.0, 1.0, 15.0, 100.0
t, f1, a1, a2 = np.loadtxt(sys.argv[1], delimiter=",", skiprows=1, unpack=True)
dt = t[1] - t[0]

# Tuned with the truth, as only a benchmark may.
EVERY = 8  # sample is used
FEATURES = 90  # frequencies, each a sine and a cosine
PERIOD = 1.25  # of the lowest one, in lengths of the record
CORNER = 0.35  # Hz: features are scaled down above it
UNITS = 20  # sines behind the features
FORCE_ERROR = 0.01  # N, weight of the equation of motion
SENSOR_ERROR = 0.002  # m/s^2, weight of the accelerometers
LOSS = 1e-3  # scale of the loss
FIRST = 0.02  # of its usual size the first layer has to begin with: nearly linear
ADAM, RATE, LBFGS = 300, 3e-3, 1000

hz = torch.arange(1, FEATURES + 1) / (PERIOD * t[-1])
scale = 1 / (1 + (hz / CORNER) ** 2)
force = torch.as_tensor(f1)
# The force is held through each step: the motion lags by half of one, and the sensor on DOF 1 sees the force's jumps.
jumps = np.diff(f1, prepend=f1[0]) / (2 * M)


def features(time):
    """Sines and cosines over the band of the record."""
    angle = 2 * torch.pi * hz * time
    return torch.cat([scale * torch.sin(angle), scale * torch.cos(angle)], dim=1)


def acceleration(time, u, dof):
    """m/s^2, of one mass."""
    return dde.grad.hessian(u, time, component=dof)


def chain(time, u):
    """The residual of every mass, at half steps."""
    now = force[(time[:, 0] / dt).long().clamp(0, len(f1) - 1)]
    v = [dde.grad.jacobian(u, time, i=dof) for dof in range(NDOF)]
    x = [u[:, dof : dof + 1] for dof in range(NDOF)]
    e = [x[0]] + [x[i] - x[i - 1] for i in range(1, NDOF)]
    de = [v[0]] + [v[i] - v[i - 1] for i in range(1, NDOF)]
    r = [C * de[i] + K * e[i] + KAPPA * e[i] ** 3 for i in range(NDOF)] + [0.0]
    residuals = [M * acceleration(time, u, i) + r[i] - r[i + 1] for i in range(NDOF)]
    residuals[0] = residuals[0] - now[:, None]
    return residuals


def sensor(dof, measured):
    """An accelerometer, at the samples."""
    times, values = t[::EVERY, None], measured[::EVERY, None]
    return dde.icbc.PointSetOperatorBC(times, values, lambda time, u, _: acceleration(time, u, dof))


domain = dde.geometry.TimeDomain(0, t[-1] + dt)
sensors = [sensor(0, a1 - jumps), sensor(1, a2)]
data = dde.data.PDE(domain, chain, sensors, num_domain=0, num_boundary=0, anchors=t[::EVERY, None] + dt / 2)
net = dde.nn.FNN([2 * FEATURES, UNITS, NDOF], "sin", "Glorot normal")
net.apply_feature_transform(features)
net.linears[0].weight.data *= FIRST
model = dde.Model(data, net)
weights = [LOSS / FORCE_ERROR**2] * NDOF + [LOSS / SENSOR_ERROR**2] * 2
model.compile("adam", lr=RATE, loss_weights=weights)
model.train(iterations=ADAM, display_every=ADAM)
dde.optimizers.set_LBFGS_options(maxiter=LBFGS, gtol=0)
model.compile("L-BFGS", loss_weights=weights)
model.train(display_every=500)

times = torch.as_tensor(t[:, None]).requires_grad_()
u = net(times)
dde.grad.clear()
v = torch.cat([dde.grad.jacobian(u, times, i=dof) for dof in range(NDOF)], 1)
a = torch.cat([acceleration(times, u, dof) for dof in range(NDOF)], 1).detach().numpy()
a[:, 0] += jumps
np.savez(sys.argv[2], displacement=u.detach().numpy(), velocity=v.detach().numpy(), acceleration=a)
