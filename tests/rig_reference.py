"""Prints the reference values of src/rig/tests.rs: python3 tests/rig_reference.py (needs opencv-python, numpy)."""
import cv2, numpy as np

K = np.array([[1201.1, 0, 322.5], [0, 1198.7, 243.2], [0, 0, 1]])
P = np.array([[30., -20., 480.], [-95., 70., 500.]])
ALL = [-.12, .03, -4e-4, 7e-4, .2, .11, -.05, .07, 1e-3, -2e-3, 3e-3, -4e-3, .02, -.03]
for n in (0, 4, 5, 8, 12, 14):
    d = np.array(ALL[:n]) if n else None
    p, J = cv2.projectPoints(P, np.zeros(3), np.zeros(3), K, d)
    print(n, "project", p.ravel().tolist(), "by translation", J[0:2, 3:6].ravel().tolist())

fs = cv2.FileStorage("replay/conveyor/calibration.yaml", cv2.FILE_STORAGE_READ)
M1, D1, M2, D2, R, T = (fs.getNode(k).mat() for k in ("M1", "D1", "M2", "D2", "R", "T"))
left, right = np.array([[[140.25, 410.5]]]), np.array([[[150.75, 398.125]]])
criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 500, 1e-15)
l = cv2.undistortPoints(left, M1, D1, None, None, None, criteria)
r = cv2.undistortPoints(right, M2, D2, None, None, None, criteria)
print("undistort", l.ravel().tolist(), r.ravel().tolist())
t = T.ravel()
E = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]]) @ R
F = np.linalg.inv(M2).T @ E @ np.linalg.inv(M1)
lp = cv2.undistortPoints(left, M1, D1, None, None, M1, criteria)
rp = cv2.undistortPoints(right, M2, D2, None, None, M2, criteria)
lc, rc = cv2.correctMatches(F, lp, rp)
X = cv2.triangulatePoints(M1 @ np.eye(3, 4), M2 @ np.hstack([R, T]), lc[0].T, rc[0].T).ravel()
print("triangulate", (X[:3] / X[3]).tolist(), "residual", float(np.sqrt(((lc - lp) ** 2).sum() + ((rc - rp) ** 2).sum())))
print("essential", E.ravel().tolist())
