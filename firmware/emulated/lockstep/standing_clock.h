/* What a board has to offer for lockstep: a clock that goes on by a tick in board_wait, and stands still in these. */
#ifndef STANDING_CLOCK_H
#define STANDING_CLOCK_H

/* Sleep until an interrupt. */
void board_idle(void);

/* End the emulation. */
void board_end(void);
#endif
