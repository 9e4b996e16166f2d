# Two commands for a newcomer: `make serve` and `make test`. Both set up what they need, once.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
export NUMBA_CACHE_DIR ?= $(CURDIR)/.cache/numba
export OPENBLAS_NUM_THREADS ?= 1

# The page is built where npm is, and only when its sources are newer.
DASHBOARD := clients/dashboard
TYPESCRIPT := clients/typescript
STATIC := service/static/index.html
HAS_NPM := $(shell command -v npm 2>/dev/null)
PAGE := $(if $(HAS_NPM),$(STATIC),no-dashboard)
DASHBOARD_SOURCES := $(wildcard $(addprefix $(DASHBOARD)/,index.html package.json package-lock.json vite.config.ts)) \
	$(shell find $(DASHBOARD)/src $(TYPESCRIPT)/src -type f 2>/dev/null)

# A kernel is compiled once, and again where it or one that it calls changed; see verbs/kernels/compile.py.
WARM := $(NUMBA_CACHE_DIR)/.warm
KERNELS := $(shell grep -rl --include='*.py' '^@kernel' verbs service)

.PHONY: help setup serve dashboard dist try-dist test check lint types lock generate load bench-streams bench-crowd bench-idle bench-page bench-encodings bench-scaling bench-refine bench chaos reliability fuzz try-image audit sbom licences clean

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | sort | expand -t 12

setup: $(VENV)/.ready  ## create .venv and install the locked packages

# `make UV=0 …` uses pip alone; slower, and needs nothing but pip.
$(VENV)/.ready: pyproject.toml requirements.lock
	@echo "setup: installing the locked packages into $(VENV) (once; later runs work offline)"
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
ifeq ($(UV),0)
	@$(BIN)/pip install -q --require-hashes -r requirements.lock
	@$(BIN)/pip install -q hatchling
	@$(BIN)/pip install -q --no-deps --no-build-isolation -e . -e clients/python
else
	@$(BIN)/pip install -q uv
	@$(BIN)/uv pip install -q --compile-bytecode --python $(BIN)/python --require-hashes -r requirements.lock
	@$(BIN)/uv pip install -q --compile-bytecode --python $(BIN)/python --no-deps -e . -e clients/python
endif
	@touch $@

serve: setup $(PAGE) $(WARM)  ## start the server on 127.0.0.1:8000 (ADVERB_PORT, ADVERB_DATA, … are honoured)
	@exec $(BIN)/adverb serve

$(WARM): $(VENV)/.ready verbs/kernels/compile.py service/run/warmup.py $(KERNELS)
	@echo "setup: compiling kernels (a minute at first, seconds after a change)"
	@$(BIN)/python -m service.run.warmup
	@touch $@

dashboard: $(DASHBOARD)/node_modules  ## build the dashboard, which the server gives at /
	@npm --prefix $(DASHBOARD) run --silent build -- --logLevel warn

ifneq ($(HAS_NPM),)
$(STATIC): $(DASHBOARD_SOURCES)
	@echo "serve: building the dashboard"
	@$(MAKE) -s dashboard || echo "serve: the dashboard could not be built (see above); going on without changes to it"
else
.PHONY: no-dashboard
no-dashboard:
	@test -e $(STATIC) || echo "serve: without the dashboard; where npm is, \`make dashboard\` builds it"
endif

%/node_modules: %/package-lock.json
	@echo "setup: installing the locked packages of $* (once; later runs work offline)"
	@npm --prefix $* ci --silent --no-audit --no-fund
	@touch $@

$(TYPESCRIPT)/dist: $(TYPESCRIPT)/node_modules $(shell find $(TYPESCRIPT)/src -type f 2>/dev/null)
	@npm --prefix $(TYPESCRIPT) run --silent build
	@touch $@

# Tests of the TypeScript client against a server run the built package.
PACKAGE := $(if $(HAS_NPM),$(TYPESCRIPT)/dist)

dist: setup $(PACKAGE)  ## build wheels, the npm package, and archives of the other clients: dist
	@mkdir -p dist
	@$(BIN)/pip wheel -q --no-deps -w dist . ./clients/python
	@$(if $(HAS_NPM),npm pack --silent --ignore-scripts --pack-destination dist ./$(TYPESCRIPT) >/dev/null,echo "dist: without npm, the npm package is left out")
	@$(BIN)/python -m tools.dist
	@ls dist

try-dist: dist  ## install each part of dist into an empty environment, and run its first example there
	@$(BIN)/python -m tools.try_dist

# Readers of glTF and VRM by others, which the tests compare our files with.
STRANGERS := tests/strangers

# All of it on two workers; of `make test T=…` what T names: files, folders or options of pytest (T="-k guard").
test: setup $(PAGE) $(PACKAGE) $(WARM) $(if $(HAS_NPM),$(STRANGERS)/node_modules)  ## run the whole test suite, or with T=… a part of it
ifdef T
	@$(BIN)/python -m pytest $(T)
else
	@$(BIN)/python -m pytest -n 2 --dist loadfile
	@$(if $(HAS_NPM),npm --prefix $(TYPESCRIPT) test --silent && npm --prefix $(DASHBOARD) test --silent,echo "test: without npm, the tests of the page and the TypeScript client are left out")
endif

check: lint types  ## lint, types, and the tests that the change against the main branch touches
	@tests="$$($(BIN)/python -m tools.affected_tests)"; \
		if [ -n "$$tests" ]; then $(BIN)/python -m pytest -m "not slow" $$tests; else echo "check: no test is touched"; fi

lint: setup  ## style, imports, architecture, lock files
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/lint-imports --no-cache
	@! grep -n '://' requirements.lock requirements.runtime.lock requirements.supply.lock requirements.fuzz.lock \
		$(DASHBOARD)/package-lock.json $(TYPESCRIPT)/package-lock.json $(STRANGERS)/package-lock.json || \
		(echo "lock files must name no address" && false)
	@$(if $(HAS_NPM),$(MAKE) -s $(TYPESCRIPT)/node_modules $(DASHBOARD)/node_modules && npm --prefix $(TYPESCRIPT) run --silent lint && npm --prefix $(DASHBOARD) run --silent lint,echo "lint: without npm, the page and the TypeScript client are left out")

types: setup  ## mypy --strict
	@$(BIN)/mypy

lock: setup  ## resolve the newest allowed versions into the lock files
	@$(BIN)/uv pip compile -q --universal --python-version 3.11 --generate-hashes --group dev pyproject.toml -o requirements.lock
	@$(BIN)/uv pip compile -q --universal --python-version 3.11 --generate-hashes pyproject.toml -o requirements.runtime.lock
	@$(BIN)/uv pip compile -q --universal --python-version 3.11 --generate-hashes --group supply -o requirements.supply.lock
	@$(BIN)/uv pip compile -q --universal --python-version 3.11 --generate-hashes --group fuzz -o requirements.fuzz.lock

generate: setup  ## rewrite generated files: openapi.json, vectors of evaluators, a recorded stream, the TypeScript client's types of it, built-in verbs
	@$(BIN)/python -m tools.authoring
	@$(BIN)/python -m tools.authoring.build
	@$(BIN)/python -m tools.openapi
	@$(BIN)/python -m tools.evaluator_vectors
	@$(BIN)/python -m tools.golden_stream
	@$(BIN)/python -m tools.mapping_table
	@$(BIN)/python -m tools.settings_table
	@$(if $(HAS_NPM),$(MAKE) -s $(TYPESCRIPT)/node_modules && npm --prefix $(TYPESCRIPT) run --silent types)

load: setup  ## ask a local server for poses and sequences for 20 s (Locust), and print what it answered
	@$(BIN)/python clients/load/rest.py --serve --seconds 20

bench-streams: setup  ## measure streams: 600 × 1 and 50 × 60 characters at 60 fps, beside a bare push loop
	@$(BIN)/python -m benchmarks.streams

bench-crowd: setup  ## measure crowds: 10,000 characters at 60 fps; BEFORE=DIR compares with another checkout
	@$(BIN)/python -m benchmarks.crowds $(if $(BEFORE),--before $(BEFORE))

bench-page: setup dashboard  ## measure a crowd of 2,000 in the page: weights, and streamed poses
	@$(BIN)/python -m benchmarks.page_crowd

bench-idle: setup  ## measure the memory of 5,000 idle streams
	@$(BIN)/python -m benchmarks.idle

bench-encodings: setup  ## measure the error of the pose encodings, 3 cm from every joint
	@$(BIN)/python -m benchmarks.encodings

bench-scaling: setup  ## fit the model of docs/scaling.md, check it at three sizes, and replace the tables there
	@$(BIN)/python -m benchmarks.scaling --write docs/scaling.md

bench-refine: setup  ## measure what a refinement costs those who are served, its speed, and how soon servers swap
	@$(BIN)/python -m benchmarks.refine

fuzz: setup $(VENV)/.fuzz $(WARM)  ## fuzz all parsers, or with F=… some: names and options of python -m tests.fuzz
	@$(BIN)/python -m tests.fuzz $(F)

$(VENV)/.fuzz: requirements.fuzz.lock
	@$(BIN)/pip install -q --require-hashes -r requirements.fuzz.lock
	@touch $@

bench: setup  ## measure speed; prints ratios in one run
	@$(BIN)/python -m benchmarks

chaos: setup $(WARM)  ## ten minutes of faults under load, or with C=… options of python -m benchmarks.chaos
	@$(BIN)/python -m benchmarks.chaos $(C)

reliability: setup $(PAGE) $(WARM)  ## run the tests of docs/reliability.md and rewrite its figures
	@$(BIN)/python -m tools.reliability

SUPPLY := .cache/supply

$(SUPPLY)/.ready: requirements.supply.lock
	@test -x $(SUPPLY)/bin/python || $(PYTHON) -m venv $(SUPPLY)
	@$(SUPPLY)/bin/pip install -q --require-hashes -r requirements.supply.lock
	@touch $@

audit: setup $(SUPPLY)/.ready  ## known vulnerabilities of the locked packages (pip-audit, npm audit)
	@$(BIN)/python -m tools.audit $(SUPPLY)/bin/pip-audit

sbom: $(SUPPLY)/.ready  ## lists of what is shipped, in the format CycloneDX: build/sbom
	@mkdir -p build/sbom
	@$(SUPPLY)/bin/cyclonedx-py requirements requirements.runtime.lock --pyproject pyproject.toml --output-reproducible \
		-o build/sbom/image.cdx.json
	@npm --prefix $(DASHBOARD) sbom --package-lock-only --omit dev --sbom-format cyclonedx >build/sbom/page.cdx.json
	@echo "sbom: build/sbom/image.cdx.json, build/sbom/page.cdx.json"

licences: setup  ## rewrite docs/licences.md
	@$(BIN)/python -m tools.licences

try-image: setup  ## build the image and start docker-compose.yml's containers, without Docker (Debian, as root)
	@$(BIN)/python -m deploy.try_image $(T)

clean:  ## remove what make made
	rm -rf $(VENV) .cache build dist service/static $(TYPESCRIPT)/dist $(addsuffix /node_modules,$(TYPESCRIPT) $(DASHBOARD) $(STRANGERS))
