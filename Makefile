# The words of this project. Each sets up what it needs; a fresh machine needs Python >= 3.11, git and GNU make.

PYTHON ?= python3
# Which build of torch where the registry offers several: cpu, or auto for the one that fits the machine's GPU.
TORCH_BACKEND ?= cpu
TORCH = 2.13.0
VENV = .venv
BIN = $(VENV)/bin
INSTALL = $(BIN)/pip install -q --no-compile
# Who imports a file first compiles it and keeps that: to compile all that is installed takes longer than it saves, and to
# keep nothing lets each process compile anew.
export PYTHONDONTWRITEBYTECODE =

.DEFAULT_GOAL = help
.PHONY: help run diagnose test check proofs audit docs paper blind real chairs load mutants clean

help:
	@echo "make run       set up, then identify the paper's plate by DE and ABC; results in runs/"
	@echo "make diagnose  set up, then find what is hidden on a plate that was hit in a virtual test"
	@echo "make test      set up, then run the tests"
	@echo "make check     format, lint, types, tests, doctests, the wheel and the documentation"
	@echo "make proofs    the tests of whole diagnoses that a shorter one stands for in make check"
	@echo "make audit     hold the pinned packages against the database of known vulnerabilities"
	@echo "make docs      the documentation, in site/"
	@echo "make paper     reproduce the paper's tables and figures (20 seeds)"
	@echo "make blind     name hidden effects in cases made by other discretisations (STRATUM=clean, workshop, tables, real or shapes; one hour)"
	@echo "make real      diagnose the measured plates of ../shared/data, where they are"
	@echo "make chairs    time three users from a file to an answer"
	@echo "make load      time and memory of large work: many runs, members, lines and elements"
	@echo "make mutants   put faults into the code one at a time and count those that no test sees (half an hour of one core)"
	@echo "make clean     remove the virtual environment and caches"

# Two searches run side by side, each with one thread: on matrices so small a second one waits more than it works.
run: export OMP_NUM_THREADS = 1
run: $(VENV)/.run
	$(BIN)/python -m torchplate.studies.main_job

# As `torchplate diagnose` does by itself: on models one at a time more threads than one are slower.
diagnose: export OMP_NUM_THREADS = 1
diagnose: $(VENV)/.run
	$(BIN)/python -m torchplate.studies.hidden_effect

# A process for each core takes the tests file by file, with one thread: on small matrices the threads of two pools that
# share few cores wait for each other. In their order: files of few tests, among them the longest, would else come last,
# and one process would wait for another.
test check proofs: export OMP_NUM_THREADS = 1
# Of every function its first three in each test, not only the first: see tests/conftest.py.
check: export CHECKED_CALLS = 3
PARALLEL = -n auto --dist loadfile --no-loadscope-reorder

test: $(VENV)/.test
	$(BIN)/python -m pytest $(PARALLEL)

# Where fits end differs from processor to processor: these hold on each.
ROUNDING = $(foreach name,ranking tolerance exchange fit criterion channels null imperfect holes,tests/diagnosis/test_$(name).py) \
  tests/diagnosis/test_change.py::test_what_drifts_is_integrated_about_where_it_went_however_sharp_the_peaks

check: $(VENV)/.docs
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/python -m pytest $(PARALLEL) -m 'not proof' --doctest-modules src tests
	@here=$$($(BIN)/python -c 'import torch; print(torch.backends.cpu.get_cpu_capability().lower())'); \
	for kind in default avx2; do [ $$kind != $$here ] || continue; echo "as a processor of kind $$kind rounds"; \
	  CHECKED_CALLS=0 ATEN_CPU_CAPABILITY=$$kind $(BIN)/python -m pytest $(PARALLEL) -q -m 'not proof' $(ROUNDING) || exit 1; done

proofs: $(VENV)/.test
	$(BIN)/python -m pytest $(PARALLEL) -m proof

# The database is asked over the network. Where it does not answer, or does not know a package, that one was not audited,
# which is said.
audit: $(VENV)/.check
	@$(BIN)/pip install -q -e '.[audit]' -c constraints.txt
	@found=$$($(BIN)/pip-audit --requirement constraints.txt --no-deps --disable-pip --progress-spinner off 2>&1); \
	status=$$?; echo "$$found" | tail -n 40; \
	pinned=$$(grep -c == constraints.txt); unknown=$$(echo "$$found" | grep -c "could not be audited"); \
	case "$$status-$$unknown-$$found" in \
	  0-0-*) ;; \
	  *"Found "*" known vulnerabilit"*) \
	    echo "Expected pinned packages without a known vulnerability, got those above. Raise them in constraints.txt." >&2; exit 1;; \
	  0-*) echo "The database does not know $$unknown of the $$pinned pinned packages, named above: those were not audited. Run make audit where its whole database can be reached." >&2; exit 2;; \
	  *) echo "The database of known vulnerabilities did not answer: nothing was audited. Run make audit where it can be reached." >&2; exit 2;; \
	esac

# The theme would print an advertisement of the next major version of mkdocs.
docs: $(VENV)/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet --strict
	@echo "Open site/index.html; its search works where a server serves it: $(BIN)/python -m http.server --directory site"

paper: $(VENV)/.run
	$(BIN)/python -m torchplate.studies.paper

# STRATUM=workshop, tables, real or shapes; CASES=0:20, say.
SET ?= I
STRATUM ?= clean
CASES ?= 0:
blind: export OMP_NUM_THREADS = 1
blind: $(VENV)/.test
	@for set in $(SET); do $(BIN)/python tests/blind --stratum $(STRATUM) --set $$set --out runs/blind/$$set --cases $(CASES) || exit 1; done

real: $(VENV)/.run
	$(BIN)/python -m torchplate.studies.real

chairs: $(VENV)/.run
	$(BIN)/python -m torchplate.studies.chairs

load: export OMP_NUM_THREADS = 1
load: $(VENV)/.run
	$(BIN)/python -m torchplate.studies.load

# Of one seed, so that the same ones are drawn again.
mutants: export OMP_NUM_THREADS = 1
mutants: $(VENV)/.test
	$(BIN)/python tests/trust/mutating.py --mutants 214 --seed 1 --write

clean:
	rm -rf $(VENV) site .pytest_cache .mypy_cache .ruff_cache .hypothesis

# torch first, by the name of its CPU build: elsewhere than on Linux there is only one build, and where the registry
# carries only the build with CUDA, uv knows where the CPU build is. So CUDA never comes by accident.
$(VENV)/.torch: constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "Expected Python 3.11 or newer, got $$($(PYTHON) --version 2>&1). Give one: make PYTHON=python3.11" >&2; exit 2; }
	$(PYTHON) -m venv $(VENV)
	@case "$(TORCH_BACKEND)-$$(uname -s)" in \
	  cpu-Linux) $(INSTALL) "torch==$(TORCH)+cpu" -c constraints.txt 2>$(VENV)/pip.log \
	    || { $(BIN)/pip install -q uv && $(BIN)/uv pip install -q --python $(BIN)/python --torch-backend cpu torch==$(TORCH); } \
	    || { cat $(VENV)/pip.log >&2; echo "Expected a CPU build of torch $(TORCH), found none. Install it into $(VENV) by hand and run make again." >&2; exit 2; };; \
	  cpu-*) $(INSTALL) torch==$(TORCH);; \
	  *) $(BIN)/pip install -q uv && $(BIN)/uv pip install -q --python $(BIN)/python --torch-backend $(TORCH_BACKEND) torch==$(TORCH);; \
	esac
	@touch $@

# Each has what those before it have.
$(VENV)/.run: $(VENV)/.torch pyproject.toml
	$(INSTALL) -e . -c constraints.txt
	@touch $@

$(VENV)/.test: $(VENV)/.torch pyproject.toml
	$(INSTALL) -e '.[test]' -c constraints.txt
	@touch $@ $(VENV)/.run

$(VENV)/.check: $(VENV)/.torch pyproject.toml
	$(INSTALL) -e '.[test,check]' -c constraints.txt
	@touch $@ $(VENV)/.run $(VENV)/.test

$(VENV)/.docs: $(VENV)/.torch pyproject.toml
	$(INSTALL) -e '.[test,check,docs]' -c constraints.txt
	@touch $@ $(VENV)/.run $(VENV)/.test $(VENV)/.check
