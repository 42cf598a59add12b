"""metric-learn's LMNN on one training set, in an environment of its own (it needs scikit-learn < 1.8).

python lmnn_peer.py TRAIN.npz RESULT.npz '{"learn_rate": 1e-5}'
"""

import json
import sys
import time
import warnings

import numpy as np
from metric_learn import LMNN

warnings.simplefilter("ignore")
train, result, settings = sys.argv[1:]
with np.load(train) as data:
    X, y = data["X"], data["y"]
start = time.perf_counter()
fitted = LMNN(random_state=0, **json.loads(settings)).fit(X, y)
np.savez(result, L=fitted.components_, seconds=time.perf_counter() - start)
