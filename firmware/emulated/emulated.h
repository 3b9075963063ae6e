/* For who wants to look at the world behind the emulated hardware. */
#ifndef EMULATED_H
#define EMULATED_H
#include "world.h"

const world_out *emulated_world(void);
#endif
