"""The simulated microscope's other scenes: a printed sheet or a plain plate in place of the vessel."""

import cv2
import numpy as np

from mrnav_server.core.arrays import ByteArray, FloatArray

_PAPER = 214.0
_INK = 42.0
_TEXELS = 4
"""Texels a module is drawn with."""


def sheet_picture(
    board: ByteArray,
    module_um: float,
    floor_um: FloatArray,
    center_um: tuple[float, float],
    angle_deg: float = 0.0,
) -> ByteArray:
    """Paint a printed board that lies on the channel's floor.

    Args:
        board: Black and white, one pixel a module, shape (rows, columns), uint8.
        module_um: Side of a module in µm.
        floor_um: The floor point that each pixel shows, shape (height, width, 2).
        center_um: Where the board's centre lies on the floor.
        angle_deg: How it is turned, from x towards y.

    Returns:
        Shape (height, width, 3), BGR, uint8; paper where there is no board.
    """
    turn = np.deg2rad(angle_deg)
    x, y = floor_um[..., 0] - center_um[0], floor_um[..., 1] - center_um[1]
    along, across = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
    # Texels about as large as the camera's pixels: bilinear edges then lie true to parts of a pixel.
    fine = np.kron(board, np.ones((_TEXELS, _TEXELS), np.uint8)).astype(np.float32)
    fine = cv2.GaussianBlur(255.0 - fine, (0, 0), 0.7).astype(np.float32) / np.float32(255.0)
    texel_um = module_um / _TEXELS
    rows, columns = fine.shape
    ink = cv2.remap(
        fine,
        (along / texel_um + (columns - 1) / 2.0).astype(np.float32),
        (across / texel_um + (rows - 1) / 2.0).astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=0.0,
    )
    gray = cv2.GaussianBlur(np.float32(_PAPER) + np.float32(_INK - _PAPER) * ink, (0, 0), 0.8)
    return cv2.cvtColor(np.rint(gray).astype(np.uint8), cv2.COLOR_GRAY2BGR).astype(np.uint8)
