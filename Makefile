# Both main targets set everything up by themselves: Python 3.11 or newer and make are all they need.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
CORE := $(VENV)/.core
DEV := $(VENV)/.dev
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable
SEED ?= 0

.PHONY: demo test test-slow lint types floors pytest docs docs-gallery links package bench results studies baselines clean help

help:
	@echo "make demo       run the closed loop on breathing tissue; results in runs/demo"
	@echo "make test       everything that gates a change"
	@echo "make test-slow  the long tests"
	@echo "make docs       build the documentation's site into build/docs"
	@echo "make links      check the documentation's links to other sites"
	@echo "make package    build sdist and wheel, and try them in an empty environment"
	@echo "make bench      measure every stage; results in runs/bench"
	@echo "make results    measure the committed results anew"
	@echo "make studies    run all studies in full"
	@echo "make baselines  train all learners of examples/learning"

$(CORE): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "laploop needs Python 3.11 or newer; this is " + sys.version.split()[0] + " (choose another with make PYTHON=...)")'
	$(PYTHON) -m venv $(VENV)
	$(PIP) .
	@touch $(CORE)

$(DEV): $(CORE)
	$(PIP) ".[dev]"
	@touch $(DEV)

demo: $(CORE)
	$(BIN)/laploop demo --seed $(SEED) --out runs/demo

test: lint types floors docs pytest

lint: $(DEV)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(DEV)
	$(BIN)/mypy

floors: $(DEV)
	$(BIN)/lint-imports

pytest: $(DEV)
	$(BIN)/pytest --numprocesses logical --dist loadfile

test-slow: $(DEV)
	$(BIN)/pytest -m slow --timeout 3600

SPHINX = $(BIN)/python -P -m sphinx --quiet --fail-on-warning --keep-going

docs: $(DEV)
	$(SPHINX) -b html docs build/docs

# The same site with the examples run, so that it shows what they print and draw.
docs-gallery: $(DEV)
	$(SPHINX) -D plot_gallery=1 -b html docs build/docs

# Asks other machines, so it is no part of the gate, which checks the links within the documentation.
links: $(DEV)
	$(SPHINX) -b linkcheck docs build/links

package: $(DEV)
	$(BIN)/pytest -m slow --timeout 3600 tests/test_package.py

bench: $(CORE)
	$(BIN)/laploop bench --out runs/bench

# The numbers of docs/results, measured anew with the shipped weights: a few hours on two cores.
RESULTS := docs/results
FRAMES ?= runs/frames
PAIRS ?= runs/pairs
NETWORKS = $(shell $(BIN)/python -P -c 'from laploop.perception import NETWORKS; print(*NETWORKS.names())')
MODELS = $(NETWORKS) phase
ORGANS := bowel-loops lobes stomach

results: $(DEV)
	mkdir -p $(RESULTS)
	$(BIN)/laploop tasks --seeds 30 --workers 2 --out runs/tasks && cp runs/tasks/summary.json $(RESULTS)/tasks.json
	$(BIN)/laploop tasks --seeds 30 --workers 2 --fidelity fast --out runs/tasks-fast && cp runs/tasks-fast/summary.json $(RESULTS)/tasks-fast.json
	for estimator in oracle $(MODELS); do for motion in still breathing; do \
	  $(BIN)/laploop trials --perception $$estimator --motion $$motion --seeds 10 --workers 2 --out runs/trials-$$estimator-$$motion \
	  && cp runs/trials-$$estimator-$$motion/summary.json $(RESULTS)/trials-$$estimator-$$motion.json || exit 1; done; done
	for organ in $(ORGANS); do $(BIN)/laploop phantom --family $$organ --out runs/$$organ.stl; for task in reach track scan; do \
	  if [ $$task = scan ]; then motion=still; else motion=breathing; fi; \
	  $(BIN)/laploop trials --task $$task --phantom runs/$$organ.stl --motion $$motion --seeds 10 --workers 2 \
	  --out runs/organs-$$organ-$$task && cp runs/organs-$$organ-$$task/summary.json $(RESULTS)/organs-$$organ-$$task.json \
	  || exit 1; done; done
	$(BIN)/laploop synthesize --train-tissues 0 --val-tissues 0 --seed 30 --out $(FRAMES)
	$(BIN)/laploop evaluate --dataset $(FRAMES) --models phase compact ssle-phase --out runs/depth
	for network in compact ssle-phase; do cp runs/depth/depth.json assets/weights/$$network.json || exit 1; done
	$(BIN)/laploop synthesize --worlds 0.75 --varied-light 0.5 --randomised-scopes 0.15 --randomised-appearances 0.3 \
	  --large-tool-share 0.15 --ill-exposed-share 0.05 --ranges.light 0.3 2.2 --train-tissues 0 --val-tissues 36 --test-tissues 36 \
	  --frames-per-tissue 8 --seed 23 --out runs/worlds
	$(BIN)/laploop synthesize --held-out --worlds 1 --train-tissues 0 --val-tissues 0 --test-tissues 40 --frames-per-tissue 5 --seed 21 \
	  --out runs/held-out
	for set in worlds held-out; do $(BIN)/laploop evaluate --dataset runs/$$set --models phase compact ssle-phase --out runs/depth-$$set \
	  && cp runs/depth-$$set/depth.json $(RESULTS)/depth-$$set.json || exit 1; done
	$(BIN)/python -P -m laploop.studies.depth.blurred_truth $(RESULTS)/depth-blur.json \
	  $(FRAMES)/frames.zarr runs/worlds/frames.zarr runs/held-out/frames.zarr
	$(BIN)/laploop twin --out runs/twin && cp runs/twin/summary.json $(RESULTS)/twin.json && cp runs/twin/twin.png docs/pictures/twin.png
	$(BIN)/laploop characterize --out runs/characterization && cp runs/characterization/summary.json $(RESULTS)/characterization.json
	$(BIN)/laploop calibrate --views 20 --out runs/calibration && cp runs/calibration/summary.json $(RESULTS)/calibration.json
	$(BIN)/laploop collect --pairs 722 --out $(PAIRS) && cp $(PAIRS)/summary.json $(RESULTS)/collection.json
	$(BIN)/laploop evaluate --dataset $(PAIRS) --models $(MODELS) --against both --out runs/pairs-depth \
	  && cp runs/pairs-depth/depth.json $(RESULTS)/depth-pairs.json
	$(BIN)/laploop evaluate --dataset $(PAIRS) --models $(MODELS) --against both --residual-mm 1 --residual-deg 0.15 \
	  --out runs/pairs-residual && cp runs/pairs-residual/summary.json $(RESULTS)/depth-pairs-residual.json
	$(BIN)/laploop evaluate --dataset $(FRAMES) --models ssle-phase compact phase --robustness --out runs/robustness \
	  && cp runs/robustness/summary.json $(RESULTS)/robustness.json
	for model in $(NETWORKS); do $(BIN)/laploop speed --model $$model --threads 1 --out runs/speed-$$model \
	  && cp runs/speed-$$model/summary.json $(RESULTS)/speed-$$model.json \
	  && cp runs/speed-$$model/latency_trace.csv envs/loop/timing/traces/$$model.csv || exit 1; done
	$(BIN)/laploop fidelity --out runs/fidelity && cp runs/fidelity/summary.json $(RESULTS)/fidelity.json
	$(BIN)/laploop bench --out runs/bench && cp runs/bench/summary.json $(RESULTS)/bench.json
	$(BIN)/python -P -m laploop.studies.timing.dense_kernels $(RESULTS)/dense-kernels.json
	$(BIN)/python -P -m laploop.studies.learners.returns $(RESULTS)/learner-returns.json
	$(BIN)/python -P -m laploop.studies.synthesis.worlds_figure docs/pictures/worlds.png
	$(BIN)/laploop run --task reach --motion breathing --hold-s 4 --seconds 5.6 --no-rerun --video docs/pictures/run.webp --out runs/animation
	$(BIN)/python -P -m laploop.studies.readme.frames_figure docs/pictures/frames.png
	$(BIN)/python -P -m laploop.studies.readme.sensor_figure $(RESULTS) docs/pictures/sensor.png
	$(BIN)/python -P -m laploop.studies.readme.results_page $(RESULTS) README.md

# All studies in full, and their pages: several hours on two cores.
studies: $(DEV)
	for study in latency delay-margin error-budget pattern; do $(BIN)/laploop study $$study --workers 2 --out runs/study-$$study \
	  && cp runs/study-$$study/summary.json $(RESULTS)/study-$$study.json || exit 1; done
	$(BIN)/python -P -m laploop.studies.readme.study_pages $(RESULTS) docs/studies

# All learners with three seeds each, and their page: most of a day.
baselines: $(DEV)
	$(BIN)/laploop demonstrate --task reach --observation depth+state --fidelity fast --perception oracle --episodes 200 \
	  --out runs/demonstrations
	$(BIN)/python -P -m laploop.studies.learners.baselines examples/learning runs/baselines $(RESULTS)/baselines.json
	$(BIN)/python -P -m laploop.studies.learners.baselines_figure $(RESULTS)/baselines.json docs/pictures/baselines.png
	$(BIN)/python -P -m laploop.studies.readme.baselines_page $(RESULTS)/baselines.json docs/baselines.md

clean:
	rm -rf $(VENV) build docs/gallery runs .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
