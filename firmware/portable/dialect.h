/* The generated headers of the dialect. They are not ours to warn about. */
#ifndef DIALECT_H
#define DIALECT_H
#pragma GCC system_header
#include <trimtab/mavlink.h>
#endif
