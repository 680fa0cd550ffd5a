# `make` or `make help` lists the targets: every line "target: ... ## text" documents itself.
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
RAY := $(VENV)/.installed-ray
# Overrides for the run, as pinn-run takes them: make run ARGS="system.ndof=20 noise.snr_db=20"
ARGS ?=

.PHONY: help venv run test quick-tests test-all trust kills lint format fuzz stored audit bench bench-epochs bench-filters bench-models bench-nearly-right bench-sweeps bench-tasks calibration table1 table2 table3 table4 table5 table6 paper figures tables seeds nonlinearity paper-all \
	against-smoother bench-peers docs gallery clean

help: ## list the targets
	@awk 'BEGIN {FS = ":.*## "} /^[a-z0-9-]+:.*## / {printf "  make %-18s %s\n", $$1, $$2}' $(MAKEFILE_LIST)
	@printf '\nOverrides go into ARGS: make run ARGS="system.ndof=20 noise.snr_db=20"; `$(BIN)/pinn-run --help` lists them.\n'

venv: $(INSTALLED) ## install the package and its tools into .venv, in the exact versions of constraints.txt

# Hundreds of processes of the tests import the same libraries: what Python compiles is kept, whatever the shell says.
export PYTHONDONTWRITEBYTECODE :=

# PIP_CONSTRAINT rather than -c: it binds the isolated build environment too. Python compiles what it imports, which is a
# small part of what pip would.
INSTALL := PIP_CONSTRAINT=constraints.txt $(BIN)/python -m pip install --no-compile --quiet --disable-pip-version-check

$(INSTALLED): pyproject.toml setup.py constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) torch
	$(INSTALL) -e '.[dev]'
	@touch $@

# Large, and needed by its own tests alone.
$(RAY): $(INSTALLED)
	$(INSTALL) -e '.[ray]'
	@touch $@

run: venv ## estimate the response of the default chain (6 DOFs, Duffing) and print its fitness
	$(BIN)/pinn-run $(ARGS)

lint: venv ## ruff (rules and format) and mypy
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: venv ## let ruff sort imports, mend and format
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

test: venv ## lint, and every test that is not slow
	$(MAKE) --no-print-directory -j2 lint quick-tests

quick-tests: venv ## every test that is not slow
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n logical --maxprocesses 8 --dist loadscope -m "not slow" </dev/null

KILLS := tests/test_kills.py tests/sweep/test_killed_searches.py
test-all: lint $(RAY) ## lint, then every test but those of `make kills`
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n logical --maxprocesses 8 --dist loadscope $(addprefix --ignore ,$(KILLS))

fuzz: venv ## bad inputs of every family, 90 each, counted: each is told in one line or has a sound result (25 minutes)
	PYTHONPATH=tests OMP_NUM_THREADS=1 $(BIN)/python -m fuzz $(ARGS)

stored: venv ## tests/stored/VERSION.zip: small runs as this release leaves them, which later ones must read; once for each release
	PYTHONPATH=tests OMP_NUM_THREADS=1 $(BIN)/python -m stored

audit: ## known holes of the versions in constraints.txt; needs a network
	VENV=$(VENV) PYTHON=$(PYTHON) .ci/audit

kills: venv ## kill 100 runs, 30 sweeps and 5 searches and fill 10 disks: the same command ends with the same numbers (a quarter of an hour)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n logical -rP -m slow $(KILLS)

trust: venv ## how often is it right? random structures by other code, by the real command (hours; ARGS=--quick: 20 minutes; ARGS=--help)
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.trust $(ARGS)

calibration: venv ## how well posteriors cover over 40 noise seeds, and are sampled over 10 (half an hour; ARGS=--write: docs/method.md)
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.calibration $(ARGS)

bench: venv ## processor time, memory and GFlop/s over DOFs, durations and topologies, and a figure (ARGS=--full: an hour)
	$(BIN)/python -m benchmarks $(ARGS)

bench-tasks: venv ## seconds of what people do, and where they go (10 minutes; ARGS="--only ground --peers": beside other estimators)
	$(BIN)/python -m benchmarks.tasks $(ARGS)

bench-sweeps: venv ## throughput of sweeps with and without joblib, and what start-up costs
	$(BIN)/python -m benchmarks.sweeps $(ARGS)

bench-models: venv ## does the evidence find the law that a record comes from? 20 records, 5 laws (long)
	$(BIN)/python -m benchmarks.models

bench-nearly-right: venv ## on machines that are nearly what the model says, against an output-error fit (long; ARGS=--quick: 10 minutes)
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.nearly_right $(ARGS)

bench-filters: venv ## a hysteretic structure beside extended, unscented, ensemble and particle filters (20 minutes)
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.filters $(ARGS)

bench-epochs: venv ## time of one epoch of the paper's network, against one reverse pass per output
	$(BIN)/python -m benchmarks.epochs $(ARGS)

table1: venv ## the paper's Table 1, perturbed parameters, beside the published values
	$(BIN)/python -m pinn_cli.paper table1 $(ARGS)

table2: venv ## the paper's sparse-recovery table: six cases, uncertain and fixed parameters, published beside ours
	$(BIN)/python -m pinn_cli.paper table2 $(ARGS)

table3: venv ## the paper's parameters by noise level: uncertain and fixed prescribed parameters, published beside ours
	$(BIN)/python -m pinn_cli.paper table3 $(ARGS)

table4: venv ## the paper's parameters of the Van der Pol chain, the linear model and wrong values, published beside ours
	$(BIN)/python -m pinn_cli.paper table4 $(ARGS)

table5: venv ## the paper's state-parameter table: fitness of its six cases, published beside ours
	$(BIN)/python -m pinn_cli.paper table5 $(ARGS)

table6: venv ## the paper's Bayesian table: marginal, conditional and Laplace posteriors, published beside ours
	$(BIN)/python -m pinn_cli.paper table6 $(ARGS)

paper: venv ## outputs/paper: every run that is missing, Tables 1 to 6, Figures 1 to 14 and report.html
	$(BIN)/python -m pinn_cli.paper $(ARGS)

figures: venv ## outputs/paper/figures: Figures 1 to 14, with the runs that they need
	$(BIN)/python -m pinn_cli.paper figures $(ARGS)

seeds: venv ## outputs/paper/seeds: the cases of Tables 2 and 5 over 10 noise seeds, mean and spread, network and smoother
	$(BIN)/python -m pinn_cli.paper seeds $(ARGS)

nonlinearity: venv ## outputs/paper/nonlinearity: fitness against kappa and force, with and without model error, one figure
	$(BIN)/python -m pinn_cli.paper nonlinearity $(ARGS)

paper-all: venv ## paper, seeds and nonlinearity, all in outputs/paper/report.html
	$(BIN)/python -m pinn_cli.paper all $(ARGS)

against-smoother: venv ## our error against a Kalman smoother whose process noise is tuned with the truth (long)
	$(BIN)/python -m benchmarks.against_smoother $(ARGS)

gallery: venv ## the figures of docs/gallery, drawn anew by the commands of its pages
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.gallery $(ARGS)

bench-peers: venv ## DeepXDE, jinns, a Kalman smoother of dynamax, KOMA, pyOMA2 and this program on the same records (long; an environment of its own)
	$(BIN)/python -m benchmarks.peers $(ARGS)

tables: venv ## tables of README and docs that come from ordinary runs, written into their pages (ARGS="mlp smoother": these)
	PYTHONPATH=tests $(BIN)/python -m benchmarks.tables $(ARGS)

docs: venv ## build/docs: the documentation as a site, its links checked; no network is needed
	$(BIN)/python -m sphinx -b html -W --keep-going -q docs build/docs

clean: ## remove the environment, builds, caches and every result in outputs/
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
	find outputs -mindepth 1 ! -name .gitkeep -delete
