# Everything below works in a fresh clone; each first makes .venv, or finds it made.
#   make demo PYTHON=/path/to/python3   chooses the Python (3.10 to 3.13)
#   make demo DEMO_ARGS='--out here'    hands arguments on; the same for TEST_ARGS and so on
export PYTHON

RUN := tools/run.sh

.PHONY: help setup setup-test demo test bench bench-blind lint lock clean

help:
	@echo 'make setup        .venv with ROS 2 Jazzy, our messages and this package'
	@echo 'make demo         from a recorded bag to identified parameters and a report in out/'
	@echo 'make test         the whole test suite'
	@echo 'make bench        messages per second, loss and latency; the speed of the simulator'
	@echo 'make bench-blind  diagnosis of bags whose cause it is not told'
	@echo 'make lint         ruff and mypy'
	@echo 'make lock         requirements/lock/ anew from requirements/*.in'
	@echo 'make clean        remove .venv, out/ and what builds leave'

setup:
	@tools/set_up.sh

setup-test:
	@tools/set_up.sh test

demo: setup
	@$(RUN) saddlering demo $(DEMO_ARGS)

test: setup-test
	@$(RUN) python -m pytest $(TEST_ARGS)

bench: setup-test
	@$(RUN) python benchmarks/run.py $(BENCH_ARGS)

bench-blind: setup-test
	@$(RUN) python benchmarks/blind.py $(BENCH_ARGS)

lint: setup-test
	@$(RUN) ruff check .
	@$(RUN) mypy saddlering_ros

lock:
	@python3 tools/lock.py

clean:
	rm -rf .venv out build install log .pytest_cache .mypy_cache .ruff_cache .hypothesis *.egg-info
