#!/usr/bin/env python3
"""Draws drawn.png and thins it with OpenCV; needs opencv-contrib-python.

    python3 tests/thinning/drawn.py tests/thinning
"""

import random
import sys
from pathlib import Path

import cv2
import numpy as np

folder = Path(sys.argv[1])
dice = random.Random(1)
mask = np.zeros((230, 310), np.uint8)
for thickness in range(1, 13):
    point = lambda: (dice.randrange(-9, 319), dice.randrange(-9, 239))
    cv2.line(mask, point(), point(), 255, thickness)
    cv2.circle(mask, point(), dice.randrange(2, 40), 255, thickness)
    cv2.rectangle(mask, point(), point(), 255, max(1, thickness // 4))
# Holes and specks of single pixels. OpenCV leaves the outermost pixels as they are: there are none.
for _ in range(2500):
    mask[dice.randrange(230), dice.randrange(310)] ^= 255
mask[[0, -1]] = mask[:, [0, -1]] = 0
cv2.imwrite(str(folder / "drawn.png"), mask)
for name, kind in [("zhangsuen", cv2.ximgproc.THINNING_ZHANGSUEN), ("guohall", cv2.ximgproc.THINNING_GUOHALL)]:
    cv2.imwrite(str(folder / f"drawn__cv_{name}.png"), cv2.ximgproc.thinning(mask, thinningType=kind))
print("OpenCV", cv2.__version__)
