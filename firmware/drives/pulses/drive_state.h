/* Outputs that follow the command by tables: nothing is remembered. */
#ifndef DRIVE_STATE_H
#define DRIVE_STATE_H

typedef struct {
    char nothing;
} drive;
#endif
