# Two commands do everything on a fresh machine with Python 3.11:
#   make demo   sets up, runs every scenario in scenarios/ and writes reports/demo/report.html
#   make test   sets up and runs linters, types, the core's tests and the quick ones of the wings
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
# uv takes a third of pip's time, and makes byte code of what is used, when it is.
UV := .venv-uv/bin/python .ci/uv.py
NEW := $(UV) venv --quiet --seed --clear --python $(PYTHON)
INSTALL := $(UV) pip install --quiet --python
HERE := $(INSTALL) $(BIN)/python --constraint requirements.lock

.PHONY: demo bits test test-all test-core rest slow light long shield-all warm check style types tables site-tests accessibility sample paper bench bench-all bench-stale others docs wheel oracles mutation mutants bounds release setup clean

demo: $(VENV)/installed
	$(BIN)/safety-harness run scenarios --out reports/demo

# What is generated, style and types; then the core, where no wing is installed, and the quick tests of the wings.
# Machine code is compiled beside the types, and what needs none of it runs next.
test: $(VENV)/tested
	$(MAKE) --no-print-directory --jobs 2 --output-sync=target tables style types warm light
	$(call run,$(QUICK) $(CORE),$(ALONE))
	$(call run,$(QUICK) $(OTHERS) $(GENERATED:%=--ignore=%))

# Everything but what is marked long.
test-all: test slow

# What tests/slow.txt names, less what LESS ignores: pytest does not ignore a file that it is given.
slow: NAMED = $(filter-out $(patsubst --ignore=%,%,$(LESS)),$(shell \
	cut -d: -f1 tests/slow.txt | sort -u | xargs -I% find tests paper/tests -name %))
slow: OF_CORE = $(filter-out $(TOY),$(filter $(addsuffix %,$(filter-out --%,$(CORE) $(LIGHT))),$(NAMED)))
slow: warm
	$(call run,$(SLOW) $(OF_CORE),$(ALONE))
	$(call run,$(SLOW) $(LESS) $(filter-out $(OF_CORE),$(NAMED)))
	$(BIN)/python $(SUITE) examples/suites --safety-derandomize --safety-world kinematic

# The core, quick and slow, where no wing is installed.
test-core: warm
	$(call run,$(LIGHT) $(CORE),$(ALONE))

# Of documents, of packaging, of the paper, of this repository.
rest: warm
	$(call run,$(REST) tests/test_architecture.py)

# One wing, quick and slow: test-field, say; or test-whole, what spans core and wings.
test-%: warm
	$(call run,tests/$*)

# Assertions as they are written: to explain each that might fail takes pytest 14 s a worker, so those that fail
# are asked again.  One thread each: more would only wait for one another.  Byte code is kept, or each of the many
# programs that the tests start makes its own.
export OMP_NUM_THREADS := 1
export PYTHONDONTWRITEBYTECODE :=
SUITE := -m pytest -n 2 --dist worksteal --assert=plain
ALONE := PYTHONPATH=$(CURDIR)/.ci/alone
QUICK := -m 'not long and not slow'
SLOW := -m 'slow and not long'
LESS :=
run = $(2) $(BIN)/python $(SUITE) $(1) || { $(2) $(BIN)/python -m pytest --last-failed --last-failed-no-failures none $(1); exit 1; }
# A toy wing, which registers parts where ours do: it hides them by itself.
TOY := tests/base/test_extension_points.py
# The tests of the core that need little machine code, and the others; those of the wings and of the whole.
LIGHT := $(addprefix tests/,scenario space trace base testing/test_parts.py testing/test_partly_measured.py \
	test_same_arithmetic.py) --ignore=$(TOY)
CORE := $(addprefix tests/,seams cell cli claims search report admission testing/plugin test_shipped_scenarios.py)
WINGS := attribution pages assurance field lab selftest gym arms worlds
OTHERS = $(addprefix tests/,$(WINGS) whole) $(REST)
REST := tests/docs tests/packaging $(addprefix tests/test_,array_shapes.py collection_order.py public_names.py \
	readme.py release.py) $(TOY) paper/tests
GENERATED := tests/docs/test_stale_tables.py tests/docs/test_pages.py tests/docs/test_glossary.py tests/test_architecture.py

light: $(VENV)/tested
	$(call run,$(QUICK) $(LIGHT),$(ALONE))

# What takes long and has a quick sibling.
long: warm
	$(INSTALL) $(BIN)/python --no-deps example-robot-data==6.0.0
	$(BIN)/python $(SUITE) -m long
	$(BIN)/python $(SUITE) examples/suites --safety-derandomize

# Machine code once, not by each worker.
warm: $(VENV)/tested
	$(BIN)/safety-harness warm

check: style types tables

style: $(VENV)/tested
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/hadolint Dockerfile

types: $(VENV)/tested
	$(BIN)/mypy

# Generated tables, schemas and the picture are as the code has them; imports point one way.
tables: $(VENV)/tested
	$(BIN)/python -m pytest -q $(QUICK) $(GENERATED)

# Ratios to RESULTS.md; others: what two of its rows compare with, each in an environment of its own
bench: $(VENV)/benchmarks
	$(BIN)/python benchmarks/results.py

others: .venv-psy-taliro/installed .venv-verifai/installed

.venv-%/installed: .venv-uv/bin/uv
	$(NEW) .venv-$*
	$(INSTALL) .venv-$*/bin/python $($*)
	touch $@

.venv-uv/bin/uv:
	$(PYTHON) -m venv .venv-uv
	.venv-uv/bin/python -m pip install --quiet --disable-pip-version-check uv==0.13.9

psy-taliro := psy-taliro==3.2.0
verifai := verifai==2.2.0

# The long tables, hours; bench-loop, say, is one of them. A change of ratios: results.py --against REVISION.
LONG := agreement arms big_pages busy campaign convergence crashes dataset decision environments \
	evaluate_faults formulas hands interval_coverage isolation kinematic kinematics_of_arms logs loop \
	monitor overhead parts proof proof_decisions public_urdfs rare_in_kinematic search_power seam shield \
	shipped_controllers soak start_up student_in_spaces training whose_fault worlds

# What differs in results from the revision BASE, kept in reports/bits; at a landing with WHOLE=--whole
bits: $(VENV)/benchmarks
	$(BIN)/python benchmarks/bits.py $(BASE) $(WHOLE)

bench-all: $(LONG:%=bench-%)

# Which tables of benchmarks/ are older than what they depend on; 1 if one is too old.
bench-stale: $(BIN)/python
	$(BIN)/python benchmarks/stale.py

bench-%: $(VENV)/benchmarks
	$(BIN)/python benchmarks/$*.py

# "safety-harness reproduce": the paper's tables and figures, measured again.
paper: $(VENV)/installed
	$(HERE) --editable '.[learning]' --editable paper

docs: $(VENV)/documented
	$(BIN)/python docs/build_site.py

# What is asked of the site, of the one that is there.
site-tests: docs $(VENV)/tested
	SAFETY_HARNESS_SITE=$(CURDIR)/site $(BIN)/python -m pytest tests/docs/test_site.py

# Into dist/, with scenarios, plans, examples (setup.py), the site, and machine code for each Python of CODE_FOR.
# What compiles much goes through ONE: CI has other work for its other processors.
CODE_FOR :=
ONE :=
wheel: docs .venv-uv/bin/uv
	$(ONE) .ci/machine_code.py $(CODE_FOR)
	rm -rf build/lib build/bdist.*
	$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir dist .

# The largest disagreement with each independent oracle, into plans/oracles.json and docs/results/self-test.md.
oracles: $(VENV)/tested
	$(BIN)/python -m pytest -q tests/cell/robot tests/cell/perception tests/cell/servoing tests/claims/formulas tests/lab/learning \
		tests/base/test_proportions.py --oracles plans/oracles.json
	$(BIN)/python docs/tables.py

# axe-core is not ours (MPL-2.0): npm install --prefix /tmp/axe axe-core
accessibility: AXE := /tmp/axe/node_modules/axe-core/axe.min.js
accessibility: $(VENV)/tested
	$(BIN)/python benchmarks/accessibility.py $(AXE)

# One small page of each kind, into reports/sample/.
sample: $(VENV)/installed
	$(BIN)/python benchmarks/sample_reports.py

# The full numbers of benchmarks/SHIELD.md: 100,000 episodes of each shielded space, 30,000 in PyBullet: hours;
# Ctrl-C whenever you like, and the same again goes on.
shield-all: $(VENV)/benchmarks
	$(BIN)/safety-harness campaign run plans/shield-hundred-thousand.yaml --out reports/shield/shield-hundred-thousand.sqlite
	$(BIN)/safety-harness campaign run plans/shield-in-pybullet.yaml --out reports/shield/shield-in-pybullet.sqlite
	$(BIN)/python benchmarks/shield.py --pairs 1000 --search 20000

# Mutants of properties/ and statistics/ that no test notices: hours, resumes; "mutmut results" lists them.
mutation: $(VENV)/tested
	$(HERE) --editable '.[mutation]'
	$(BIN)/mutmut run

# 100 mutants of the control stack, drawn by lot, into docs/mutants.json and docs/results/self-test.md: resumes.
mutants: $(VENV)/tested
	$(BIN)/python benchmarks/mutants.py
	$(BIN)/python docs/tables.py

# The tests of the control stack, compiled with a check of every index.
bounds: $(VENV)/tested
	NUMBA_BOUNDSCHECK=1 SAFETY_HARNESS_CACHE=$(CURDIR)/$(VENV)/cache-with-bounds $(BIN)/python -m pytest -q \
		tests/cell/controller tests/cell/perception tests/cell/robot tests/cell/servoing tests/cell/simulation tests/cell/avoidance/test_gate.py

# The newest versions of the ranges in pyproject.toml, for this repository.  Not kept: what torch brings for a GPU.
.PHONY: lock oldest newest crowded installed
COMPILE := $(UV) pip compile --quiet --python-version 3.11 --no-annotate --no-header pyproject.toml
lock: .venv-uv/bin/uv
	$(COMPILE) --all-extras --upgrade --output-file requirements.lock
	sed -i '/^\(cuda\|nvidia\|triton\)/d; 1i # What this repository is tested with, Python 3.11: "make lock" writes it.' \
		requirements.lock

# With the lowest and the newest versions of the ranges: what asks each dependency for something, and a run.
ASKING := $(addprefix tests/assurance/statistics/test_,binomial.py distances.py planning.py rates.py sequential.py) \
	$(addprefix tests/scenario/test_,read_scenario.py schema.py write_scenario.py) tests/trace/test_store.py \
	$(addprefix tests/space/test_,space.py strategy.py) tests/search/test_searchers.py \
	tests/cell/avoidance/test_model_file.py tests/cli/test_nearest.py tests/test_public_names.py
# Of these, what takes seconds and asks no dependency for anything that the others do not.
UNASKED := type_check test_rare adversary whole_shifts stopping_as_soon many_repetitions more_ways
oldest := lowest-direct
newest := highest
.venv-oldest/versions .venv-newest/versions: .venv-%/versions: pyproject.toml .venv-uv/bin/uv
	$(NEW) .venv-$*
	echo 'pytest>=8' | $(COMPILE) - --extra images --extra onnx --resolution $($*) --output-file $@
	$(INSTALL) .venv-$*/bin/python --constraint $@ --editable '.[images,onnx]' pytest jsonschema
oldest newest: %: .venv-%/versions
	.venv-$@/bin/python -m pip check
	$(ONE) .venv-$@/bin/safety-harness run scenarios/rendered-images.yaml --out reports/$@
	.venv-$@/bin/python -m pytest -q --assert=plain -W ignore::DeprecationWarning -p no:cacheprovider $(QUICK) $(ASKING) -k '$(UNASKED:%=not % and) not doc'

# Beside what other people install.
CROWD := torch==2.13.0 stable-baselines3 gymnasium mujoco pin rosbags
crowded: .venv-uv/bin/uv
	$(NEW) .venv-$@
	$(INSTALL) .venv-$@/bin/python $(CROWD) .
	.venv-$@/bin/python -m pip check
	.venv-$@/bin/python -c "import safety_harness, torch, stable_baselines3, gymnasium, mujoco, pinocchio, rosbags"
	.venv-$@/bin/safety-harness run scenarios/hand-visits-and-leaves.yaml --out reports/crowded

# The wheel in an empty folder, with each Python that is here.  "make installed WHEEL=" takes the newest of dist/,
# PYTHONS=--newest the newest Python alone, as CI does.
WHEEL := wheel
PYTHONS :=
installed: $(WHEEL)
	.ci/installed.py $(PYTHONS)

# An annotated tag for the version of pyproject.toml; CONTRIBUTING.md says what comes before.
release:
	.ci/release

setup: $(VENV)/installed

$(VENV)/bin/python: | .venv-uv/bin/uv
	$(NEW) $(VENV)

# With what the shipped scenarios ask for: one has rendered images.
$(VENV)/installed: pyproject.toml requirements.lock | .venv-uv/bin/uv $(VENV)/bin/python
	$(HERE) --editable '.[images,onnx]'
	touch $@

$(VENV)/tested: pyproject.toml requirements.lock | .venv-uv/bin/uv $(VENV)/bin/python
	$(HERE) --editable '.[test]' --editable paper
	touch $(VENV)/installed $(VENV)/documented $@

$(VENV)/benchmarks: $(VENV)/installed
	$(HERE) --editable '.[benchmarks]'
	touch $@

$(VENV)/documented: pyproject.toml requirements.lock | .venv-uv/bin/uv $(VENV)/bin/python
	$(HERE) --editable '.[docs]'
	touch $@

clean:
	rm -rf $(VENV) reports/demo site
