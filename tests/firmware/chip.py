"""A model of the STM32F405's registers that the board's drivers use, and of the inertial sensor on its SPI.

Written from ST's reference manual RM0090 and the data sheets DS8626 and DS-000347, not from the drivers. It models what
is asked of software: keys, orders, flags that clear when they are read, times. Where software does what the manual
forbids, an assertion fails.
"""

import ctypes

import numpy as np

HSE_HZ = 8_000_000
MODE, PULL = 0x00, 0x0C


class Icm42688:
    """Its registers of bank 0 behind SPI: an address with the read bit, then data, the address going up by itself."""

    def __init__(self):
        self.identity, self.frozen, self.dead = 0x47, False, False
        self.reset()

    def reset(self):
        self.registers = {0x75: self.identity, 0x4E: 0x00, 0x4F: 0x06, 0x50: 0x06}
        self.ready = False
        self.axes = np.full(6, -32768, dtype=np.int16)
        self.temperature = 0
        self.address = None

    def measure(self, force, rate, degrees=25.0):
        """A sample at its output rate: m/s^2 and rad/s, in the ranges that the registers ask for."""
        if self.registers[0x4E] & 0x0F != 0x0F or self.dead:
            return
        g, dps = 16.0 / 2 ** (self.registers[0x50] >> 5), 2000.0 / 2 ** (self.registers[0x4F] >> 5)
        counts = np.r_[np.asarray(force) / 9.80665 / g, np.rad2deg(rate) / dps] * 32768
        if not self.frozen:
            self.axes = np.clip(np.round(counts), -32768, 32767).astype(np.int16)
        self.temperature = round((degrees - 25.0) * 132.48)
        self.ready = True

    def select(self):
        self.address = None

    def exchange(self, byte):
        if self.dead:
            return 0xFF
        if self.address is None:
            self.reading, self.address = bool(byte & 0x80), byte & 0x7F
            return 0
        at, self.address = self.address, self.address + 1
        if not self.reading:
            self.write(at, byte)
            return 0
        if at == 0x2D:
            status, self.ready = 8 * self.ready, False
            return status
        if 0x1D <= at <= 0x2A:
            words = np.r_[np.int16(self.temperature), self.axes].astype(">i2").tobytes()
            return words[at - 0x1D]
        return self.registers.get(at, 0)

    def write(self, at, byte):
        if at == 0x11 and byte & 1:
            self.reset()
        else:
            self.registers[at] = byte


class Chip:
    """The registers by address; `connect` gives it to a library of drivers."""

    SECTORS = (0x08000000, 0x08004000, 0x08008000, 0x0800C000, 0x08010000, *range(0x08020000, 0x08100000, 0x20000))

    def __init__(self, library, *, crystal=True, slow_clock=32_000.0):
        self.crystal, self.slow_clock, self.library = crystal, slow_clock, library
        self.plain = {0x40023800: 0x83, 0x40013008: 2, 0x40020000: 0xA8000000, 0x40023C14: 0x0FFFAAED}
        self.order = []
        self.icm = Icm42688()
        self.flash, self.unlocking, self.locked = {}, [], True
        self.option_keys = []
        self.watchdog = {"on": False, "open": False, "prescaler": 0, "reload": 0xFFF, "left": None, "reset": False}
        self.now = 0.0
        self.sent = b""
        self.kept = (
            ctypes.CFUNCTYPE(ctypes.c_uint32, ctypes.c_uint32)(self.get),
            ctypes.CFUNCTYPE(None, ctypes.c_uint32, ctypes.c_uint32)(self.set),
        )
        self.faults = []
        library.model_connect(*self.kept)

    # What went wrong in a callback would be lost on its way through C: it is kept, and `check` raises it.
    def get(self, address):
        try:
            return self.read(address)
        except Exception as error:
            self.faults.append(error)
            return 0

    def set(self, address, value):
        try:
            self.order.append((address, value))
            self.write(address, value)
        except Exception as error:
            self.faults.append(error)

    def check(self):
        if self.faults:
            raise self.faults[0]

    def read(self, address):
        if 0x08000000 <= address < 0x08100000:
            return self.flash.get(address, 0xFFFFFFFF)
        if address == 0x4001300C:
            self.plain[0x40013008] &= ~1
        if 0x40000C34 <= address <= 0x40000C3C:  # captures: reading clears the flag
            self.plain[0x40000C10] = self.plain.get(0x40000C10, 0) & ~(1 << (1 + (address - 0x40000C34) // 4))
        return self.plain.get(address, 0)

    def write(self, address, value):
        if 0x08000000 <= address < 0x08100000:
            self.program(address, value)
        elif address == 0x40023800:
            self.plain[address] = value | 2 | bool(value & 1 << 16 and self.crystal) << 17 | bool(value & 1 << 24) << 25
        elif address == 0x40023808:
            assert value & 3 != 2 or self.plain[0x40023800] & 1 << 25, "switched to a PLL that does not run"
            assert value & 3 != 2 or self.plain.get(0x40023C00, 0) & 7 >= 5, "168 MHz without 5 wait states"
            self.plain[address] = value & ~0xC | (value & 3) << 2
        elif address == 0x40023874:
            self.plain[address] = 0 if value & 1 << 24 else self.plain.get(address, 0)
        elif 0x40003000 <= address <= 0x4000300C:
            self.write_watchdog(address, value)
        elif 0x40023C04 <= address <= 0x40023C14:
            self.write_flash_control(address, value)
        elif address == 0x4001300C:
            self.plain[address] = self.icm.exchange(value & 0xFF)
            self.plain[0x40013008] |= 1
        elif address == 0x40020018:
            if value & 1 << 20:
                self.icm.select()
        elif address in (0x40026408, 0x4002640C):
            self.plain[address - 8] = self.plain.get(address - 8, 0) & ~value
        else:
            self.plain[address] = value
            if address == 0x400264B8 and value & 1:
                self.send_by_dma(value)

    # --- clocks, chapter 7
    def frequencies(self):
        """System, APB1 and APB2 clock, Hz, by the registers."""
        pll = self.plain[0x40023804]
        source = HSE_HZ if pll & 1 << 22 else 16_000_000
        m, n, p = pll & 63, pll >> 6 & 511, 2 * ((pll >> 16 & 3) + 1)
        assert 1e6 <= source / m <= 2e6
        assert 100e6 <= source / m * n <= 432e6
        assert self.plain[0x40023808] >> 2 & 3 == 2
        system = source / m * n / p
        divide = [2 ** max(0, (self.plain[0x40023808] >> at & 7) - 3) for at in (10, 13)]
        return system, system / divide[0], system / divide[1]

    # --- independent watchdog, chapter 21
    def write_watchdog(self, address, value):
        w = self.watchdog
        if address == 0x40003000:
            w["open"] = value == 0x5555
            if value == 0xCCCC:
                w["on"] = True
            if value in (0xAAAA, 0xCCCC):
                w["left"] = w["reload"] + 1
        else:
            assert w["open"], "written without the key"
            w["prescaler" if address == 0x40003004 else "reload"] = value

    def pass_time(self, seconds):
        w = self.watchdog
        self.now += seconds
        if w["on"]:
            w["left"] -= seconds * self.slow_clock / (4 * 2 ** w["prescaler"])
            w["reset"] = w["reset"] or w["left"] <= 0

    # --- flash, chapter 3
    def write_flash_control(self, address, value):
        if address == 0x40023C04:
            self.unlocking = [*self.unlocking, value][-2:]
            self.locked = self.locked and self.unlocking != [0x45670123, 0xCDEF89AB]
        elif address == 0x40023C08:
            self.option_keys = [*self.option_keys, value][-2:]
        elif address == 0x40023C14:
            if not value & 1:
                assert self.option_keys == [0x08192A3B, 0x4C5D6E7F], "option bytes without their keys"
            self.plain[address] = value & ~2
        elif address == 0x40023C0C:
            self.plain[address] = self.plain.get(address, 0) & ~value
        else:
            if value & 1 << 31:
                self.locked, self.unlocking = True, []
                return
            assert not self.locked, "locked"
            assert value >> 8 & 3 == 2, "not by words"
            self.plain[address] = value
            if value & 1 << 16:
                self.erase(value >> 3 & 15)

    def program(self, address, value):
        assert not self.locked, "locked"
        assert self.plain.get(0x40023C10, 0) & 1, "PG is not set"
        assert not self.plain.get(0x40023C0C, 0) & 0xF2, "errors of before stand"
        self.flash[address] = self.flash.get(address, 0xFFFFFFFF) & value
        self.pass_time(16e-6)

    def erase(self, sector):
        assert self.plain[0x40023C10] & 2, "SER is not set"
        begin, end = self.SECTORS[sector], [*self.SECTORS[1:], 0x08100000][sector]
        self.flash = {a: w for a, w in self.flash.items() if not begin <= a < end}
        self.pass_time({0x4000: 0.5, 0x10000: 1.1}.get(end - begin, 2.0))

    # --- USART 1 by DMA, chapters 30 and 10
    def memory(self, low):
        """An address of this process from its lower half, as the register has it: data are near code."""
        near = ctypes.cast(self.library.usart_begin, ctypes.c_void_p).value
        return min(((near >> 32) + k << 32 | low for k in (-1, 0, 1)), key=lambda a: abs(a - near))

    def receive(self, data):
        """Bytes on the line while the receiver's stream runs; the count goes round and flags its end."""
        assert self.plain[0x40011014] & 1 << 6, "USART does not ask the DMA"
        assert self.plain[0x40026440] & 1, "stream is off"
        assert self.plain[0x40026440] >> 25 & 7 == 4, "another channel"
        self.size = getattr(self, "size", self.plain[0x40026444])
        to = self.memory(self.plain[0x4002644C])
        for byte in data:
            left = self.plain[0x40026444]
            ctypes.memmove(to + self.size - left, bytes([byte]), 1)
            self.plain[0x40026444] = left - 1 or self.size
            if left == 1:
                self.plain[0x40026400] = self.plain.get(0x40026400, 0) | 1 << 21

    def send_by_dma(self, control):
        assert control >> 25 & 7 == 4, "another channel"
        assert control & 1 << 6, "from memory to the line"
        assert not self.plain.get(0x40026404, 0) & 0x3D << 22, "flags of the last piece stand"
        self.sent += ctypes.string_at(self.memory(self.plain[0x400264C4]), self.plain[0x400264BC])

    def finish_sending(self):
        """The piece is out: the stream stops, flags it and calls."""
        if self.plain[0x400264B8] & 1:
            self.plain[0x400264B8] &= ~1
            self.plain[0x40026404] = self.plain.get(0x40026404, 0) | 1 << 27
            self.library.usart_sent()

    # --- timers, chapter 18
    def pulses(self):
        """Frequency of the servo frames (Hz) and widths (s) on timer 3, 84 MHz in; None where the pin is not its."""
        t = 0x40000400
        count = 84e6 / (self.plain[t + 0x28] + 1)
        frame = (self.plain[t + 0x2C] + 1) / count
        widths = [self.plain[t + 0x34 + 4 * k] / count for k in range(3)]
        on = [self.plain.get(0x40020800 + MODE, 0) >> 2 * pin & 3 == 2 for pin in (6, 7, 8)]
        return 1 / frame, [w if o else None for w, o in zip(widths, on, strict=True)]

    def edge(self, channel, at, high):
        """An edge on the receiver's channel at so many us: captured by timer 5, which calls."""
        pins = self.plain.get(0x40020010, 0)
        self.plain[0x40020010] = pins | 1 << channel if high else pins & ~(1 << channel)
        self.plain[0x40000C34 + 4 * channel] = at & 0xFFFFFFFF
        self.plain[0x40000C10] = self.plain.get(0x40000C10, 0) | 2 << channel
        self.library.receiver_captured()
