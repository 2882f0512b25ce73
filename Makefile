# make demo  — everything from nothing: clips, training, evaluation, export, inference on a video file
# make test  — lint and all tests; make test-fast leaves the slow ones out
# make bench — what is timed, against what (see benchmarks/)
# make model — trains, calibrates and exports the contact posterior that comes along (docs/identifiability.md)
PYTHON ?= python3
BIN := .venv/bin
DEMO := runs/demo
BEST := --ckpt_path $(DEMO)/training/checkpoints/best.ckpt
VIDEO := $(DEMO)/clips/video04/video04_00000
INSTALLED := .venv/.installed

.PHONY: demo test test-fast lint bench model clean

$(INSTALLED): pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[train,video,dev]"
	touch $@

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/ty check

test: lint
	$(BIN)/pytest

test-fast: $(INSTALLED)
	$(BIN)/pytest -m "not slow"

# The system is trained on stored depth and annotated masks. The frame folder of the test clip has both; its video file
# has neither and goes through the photometric depth model and the automatic masks, and the results say what that means.
demo: $(INSTALLED)
	$(BIN)/python -m data.synthetic --output $(DEMO)/clips --clips 6 --frames 32 --seed 1
	$(BIN)/python train.py fit -c configs/smoke.yaml --ckpt_path last
	$(BIN)/python train.py test -c configs/smoke.yaml $(BEST)
	$(BIN)/python train.py export -c configs/smoke.yaml $(BEST) --output $(DEMO)/parameters.onnx
	$(BIN)/python infer.py $(VIDEO) $(VIDEO).mp4 --output $(DEMO)/results --overwrite
	@$(BIN)/python infer.py $(VIDEO) --model $(DEMO)/parameters.onnx --output $(DEMO)/trained --overwrite \
		> $(DEMO)/trained.log 2>&1
	@$(BIN)/python infer.py $(VIDEO) --estimator direct --output $(DEMO)/fits --overwrite > $(DEMO)/fits.log 2>&1
	@echo
	@echo "report:   $(DEMO)/training/evaluation/report.html"
	@echo "network:  $(DEMO)/parameters.onnx"
	@echo "results:  $(DEMO)/results/*/ (parameters.csv, interactions.csv, overlay.mp4, summary.png, fit.png, run.json)"
	@ls -1 $(DEMO)/results/*/parameters.csv $(DEMO)/results/*/overlay.mp4 $(DEMO)/results/*/summary.png
	@echo
	@echo "One clip beside its truth: by the shipped network, by the one just trained, and by fitting the simulator"
	@echo "(infer.py --estimator direct):"
	@$(BIN)/python -m evaluation.beside_truth $(foreach run,results trained fits,$(DEMO)/$(run)/$(notdir $(VIDEO)))

bench: $(INSTALLED)
	$(BIN)/python -m benchmarks.rollout
	$(BIN)/python -m benchmarks.training_step
	$(BIN)/python -m benchmarks.inference

# An interrupted run goes on where it was: a finished training is kept, and so is every validation clip. After a change of
# the code `rm -r runs/contact` first, or the old training is exported again.
MODEL := runs/contact
VALIDATE := $(BIN)/python -m evaluation.benchmark --estimator network --split validation --model $(MODEL)/uncalibrated.onnx
model: $(INSTALLED) $(MODEL)/posterior.pt
	$(BIN)/python -m evaluation.calibration --weights $(MODEL)/posterior.pt --output $(MODEL)/uncalibrated.onnx
	$(VALIDATE) --suite clean 8bit noisy --clips 140 --output $(MODEL)/validation
	$(VALIDATE) --suite clean noisy --clips 40 --size 854x480 --output $(MODEL)/fine
	$(VALIDATE) --suite clean 8bit noisy --clips 100 --seen press --output $(MODEL)/pressed
	$(VALIDATE) --suite late-onset --clips 110 --onset between --output $(MODEL)/between
	$(BIN)/python -m evaluation.calibration --model $(MODEL)/uncalibrated.onnx --output models/weights/contact.onnx \
		--validation $(MODEL)/validation $(MODEL)/fine --pressed $(MODEL)/pressed --between $(MODEL)/between

$(MODEL)/posterior.pt: | $(INSTALLED)
	$(BIN)/python -m estimators.network.training --output $(MODEL)

clean:
	rm -rf .venv runs build *.egg-info
