"""The program that the board runs when it is switched on."""

from firmware.board_nrf52dk import Board, gates_low
from firmware.firmware import Firmware

try:
    firmware = Firmware(Board())
    while True:
        firmware.step()
finally:
    gates_low()  # an exception ends the loop, and then the watchdog resets the board
