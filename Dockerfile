# docker build -t pinn-run .                        the command:      docker run --rm -v "$PWD:/records" pinn-run system.ndof=20
# docker build -t pinn-run-checkout --target checkout .   the checkout: docker run --rm pinn-run-checkout make run (or make test)
#
# PyPI's torch for Linux brings CUDA along, some gigabytes. For a small image give the index of torch's CPU builds:
#   --build-arg TORCH_INDEX=<its address>
ARG PYTHON=3.11

FROM python:${PYTHON}-slim AS base
ARG TORCH_INDEX
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_CONSTRAINT=/source/constraints.txt
WORKDIR /source
COPY constraints.txt ./

FROM base AS checkout
RUN apt-get update && apt-get install -y --no-install-recommends bash git make && rm -rf /var/lib/apt/lists/*
COPY . .
RUN python -m venv .venv && .venv/bin/pip install ${TORCH_INDEX:+--index-url "$TORCH_INDEX"} torch && make venv
CMD ["make", "run"]

FROM base AS wheel
COPY pyproject.toml setup.py README.md LICENSE ./
COPY pinn_cli pinn_cli
COPY conf conf
COPY hydra_plugins hydra_plugins
RUN pip wheel --no-deps --wheel-dir /wheel .

FROM base AS command
RUN pip install ${TORCH_INDEX:+--index-url "$TORCH_INDEX"} torch
RUN --mount=from=wheel,source=/wheel,target=/wheel pip install /wheel/*.whl
# Results belong to whoever runs it: docker run --user "$(id -u):$(id -g)".
RUN useradd --create-home runner && mkdir /records && chown runner /records
ENV MPLCONFIGDIR=/tmp/matplotlib
USER runner
WORKDIR /records
ENTRYPOINT ["pinn-run"]
