/* The slave's firmware: everything happens in slave_work, called again whenever the processor wakes. */
#include "slave.h"
#include "slave_port.h"

void run(void);

void run(void) {
    static slave s;
    slave_begin(&s);
    for (;;) {
        slave_work(&s);
        slave_wait();
    }
}
