"""The board runs this when it is switched on."""

from firmware.board_nrf52dk import Board
from firmware.firmware import Firmware

firmware = Firmware(Board())
while True:
    firmware.step()  # an exception ends the loop, and then the watchdog resets the board
