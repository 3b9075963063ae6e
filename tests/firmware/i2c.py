"""A model of two I2C peripherals of the STM32F405 on one bus, to the register: ST's RM0090, chapter 27.3.

Each end is a library of drivers of its own. Bytes take no time; where the manual forbids something, an assertion fails.
"""

import ctypes

CR1, CR2, OAR1, DR, SR1, SR2 = (0x40005800 + k for k in (0x00, 0x04, 0x08, 0x10, 0x14, 0x18))
PE, START, STOP, ACK, SWRST = 1, 1 << 8, 1 << 9, 1 << 10, 1 << 15
SB, ADDR, BTF, STOPF, RXNE, TXE, AF = 1, 2, 4, 1 << 4, 1 << 6, 1 << 7, 1 << 10
BUSY, TRA = 2, 4


class End:
    """Registers of one controller: of I2C with their side effects, others as memory.

    joins: connect the library to this model and start its driver; else another model passes on what is of I2C.
    """

    def __init__(self, library, *, joins=True):
        self.library, self.plain, self.faults = library, {}, []
        self.status = self.state = self.data = 0
        self.has_read_status = False
        self.kept = (
            ctypes.CFUNCTYPE(ctypes.c_uint32, ctypes.c_uint32)(self.get),
            ctypes.CFUNCTYPE(None, ctypes.c_uint32, ctypes.c_uint32)(self.set),
        )
        if joins:
            library.model_connect(*self.kept)
            library.bus_begin()

    # What went wrong in a callback would be lost on its way through C: it is kept, and `check` raises it.
    def get(self, address):
        try:
            return self.read(address)
        except Exception as error:
            self.faults.append(error)
            return 0

    def set(self, address, value):
        try:
            self.write(address, value)
        except Exception as error:
            self.faults.append(error)

    def check(self):
        if self.faults:
            raise self.faults[0]
        assert self.speed() == 100_000

    def speed(self):
        """Of the bus, by the registers: PCLK1 of 42 MHz, and what the peripheral was told of it."""
        assert self.plain[CR2] & 63 == 42
        assert self.plain[0x40005820] == 43  # 1000 ns of rise time
        return 42e6 / (2 * self.plain[0x4000581C])

    def read(self, address):
        if address == SR1:
            self.has_read_status = True
            return self.status
        if address == SR2:
            if self.has_read_status and self.status & ADDR:
                self.status &= ~ADDR
                self.address_cleared()
            return self.state
        if address == DR:
            return self.read_data()
        return self.plain.get(address, 0)

    def write(self, address, value):
        if address == SR1:
            self.status &= value | ~0xFF00
        elif address == DR:
            self.write_data(value & 0xFF)
        elif address == CR1:
            before, self.plain[CR1] = self.plain.get(CR1, 0), value
            self.controlled(before, value)
        else:
            assert address != OAR1 or value & 1 << 14, "bit 14 of OAR1 must be kept at 1"
            self.plain[address] = value

    def address_cleared(self):
        """The software has seen ADDR."""


class Device(End):
    """The addressed end: its interrupts run at once."""

    next = None

    def controlled(self, before, value):
        if self.has_read_status:
            self.status &= ~STOPF

    def interrupt(self):
        for _ in range(4):
            if not self.status & (ADDR | RXNE | STOPF | TXE):
                return
            self.has_read_status = False
            self.library.bus_event()
        raise AssertionError(f"an interrupt that does not end, SR1 {self.status:#x}")

    def addressed(self, address, reads):
        """Whether it acknowledges."""
        if not (self.plain.get(CR1, 0) & (PE | ACK) == PE | ACK and self.plain[OAR1] >> 1 & 0x7F == address):
            return False
        self.status |= ADDR
        self.state = BUSY | (TRA if reads else 0)
        self.interrupt()
        return True

    def take(self, byte):
        self.data = byte
        self.status |= RXNE
        self.interrupt()

    def give(self):
        self.status |= TXE
        self.interrupt()
        return self.next

    def not_acknowledged(self):
        self.status = self.status & ~TXE | AF
        self.library.bus_error()
        assert not self.status & AF

    def stopped(self):
        self.state = 0
        self.status |= STOPF
        self.interrupt()

    def read_data(self):
        self.status &= ~RXNE
        return self.data

    def write_data(self, byte):
        self.next = byte
        self.status &= ~TXE


class Master(End):
    """The bus's master. device: the other end, or None where nothing is connected.  noise: changes bytes on the way."""

    def __init__(self, library, device, **options):
        self.device, self.noise, self.hangs = device, lambda byte: byte, False
        self.phase, self.shift, self.refused = "", None, False
        super().__init__(library, **options)

    def controlled(self, before, value):
        if value & SWRST:
            self.status = self.state = 0
            self.phase, self.hangs = "", False
        elif value & START:
            assert value & PE, "started while it is off"
            assert not self.state & BUSY, "started while a stop is under way"
            self.plain[CR1] &= ~START
            self.status, self.state, self.phase = SB, BUSY, "start"
        elif value & STOP and self.state & BUSY:
            assert self.phase != "receives" or self.refused or self.status & AF, "stopped before a byte was refused"
            self.plain[CR1] &= ~STOP
            if self.phase == "sends" and self.device and self.device.state:
                self.device.stopped()
            self.status &= ~(SB | TXE | (BTF if self.phase == "sends" else 0))
            self.state = BUSY if self.hangs else 0

    def write_data(self, byte):
        if self.phase == "start":
            assert self.has_read_status, "SB is cleared by reading SR1 first"
            self.status &= ~SB
            self.phase = "receives" if byte & 1 else "sends"
            heard = self.device is not None and self.device.addressed(byte >> 1, bool(byte & 1))
            self.status |= ADDR if heard else AF
            self.shift, self.refused = None, False
        else:
            assert self.phase == "sends"
            assert not self.status & ADDR, "ADDR was not cleared"
            self.device.take(self.noise(byte))
            self.status |= TXE | BTF

    def address_cleared(self):
        if self.phase == "sends":
            self.status |= TXE
        else:
            self.fetch()
            self.fetch()

    def fetch(self):
        """The next byte into data or shift register; the last one was not acknowledged, or it is acknowledged now."""
        if self.refused or (self.status & BTF):
            return
        byte, self.refused = self.noise(self.device.give()), not self.plain[CR1] & ACK
        if self.status & RXNE:
            self.shift = byte
            self.status |= BTF
        else:
            self.data = byte
            self.status |= RXNE
        if self.refused:
            self.device.not_acknowledged()

    def read_data(self):
        assert self.status & RXNE, "read where there is nothing"
        byte = self.data
        if self.status & BTF:
            self.data, self.shift = self.shift, None
            self.status &= ~BTF
        else:
            self.status &= ~RXNE
        self.fetch()
        return byte
