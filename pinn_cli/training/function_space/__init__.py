"""Gauss-Newton training of any multilayer perceptron, with as many unknowns as residuals instead of weights.

A damped Gauss-Newton step of w weights solves a (w, w) system; the push-through identity

    (J' J + a I)^-1 J' = J' (J J' + a I)^-1

turns it into one of the size of the residuals, whose matrix J J' (the neural tangent kernel) is built from what layers
get and from sensitivities, without the Jacobian J. Natural gradients of PINNs: Mueller and Zeinhofer 2023, "Achieving
high accuracy with PINNs via energy natural gradient descent"; steps of the size of the residuals in physics: Chen and
Heyl 2024, "Empowering deep neural quantum states through efficient optimization".
"""
