"""Writes the files of this folder: pip install scikit-learn skl2onnx, then python make.py.

Each is fitted to the same questions, (n, 6): a hand and a TCP [m]; the answer is 0.1 m above the TCP.
"""

from pathlib import Path

import numpy as np
from skl2onnx import to_onnx
from sklearn.ensemble import RandomForestRegressor
from sklearn.linear_model import LinearRegression
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

QUESTION = np.array([[0.8, -0.3, 0.1, 0.7, 0.0, 0.35]], np.float32)
FITTED = {
    "linear": LinearRegression(),
    "mlp": make_pipeline(
        StandardScaler(), MLPRegressor(hidden_layer_sizes=(16,), max_iter=500, random_state=0)
    ),
    "forest": RandomForestRegressor(5, max_depth=4, random_state=0),
}

if __name__ == "__main__":
    rng = np.random.default_rng(0)
    questions = rng.uniform(-1.0, 1.0, (200, 6)).astype(np.float32)
    answers = questions[:, 3:] + np.array([0.0, 0.0, 0.1], np.float32)
    for name, model in FITTED.items():
        model.fit(questions, answers)
        data = to_onnx(model, questions[:1]).SerializeToString()
        Path(__file__).with_name(f"{name}.onnx").write_bytes(data)
        print(name, len(data), model.predict(QUESTION)[0].round(5).tolist())
