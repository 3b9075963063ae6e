/* This text may be used, changed and passed on for any purpose, under any licence or none, without notice; it comes
 * without warranty. */

/* Code shared by FMI 2.0 and 3.0: instances of a model, their variables by offset, and the state as one struct.
 *
 * model.h is generated: MODEL_TOKEN, MODEL_WORKSPACE, model_data, model_defaults, model_begin, model_advance and
 * model_variables. Everything here is static, so that FMUs can be linked together from source.
 */
#ifndef FMU_H
#define FMU_H

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define FMU_UNSTAMPED INT64_MIN /* a message with this time counts as current */
#define FMU_TICKS 1e7           /* time units per second */

typedef enum { FMU_F64, FMU_F32, FMU_I32, FMU_I64, FMU_U32, FMU_BOOL } fmu_type;
typedef enum { FMU_FIXED, FMU_TUNABLE, FMU_INPUT, FMU_OUTPUT } fmu_role;
typedef enum { FMU_NEW, FMU_INITIALISING, FMU_STEPPING, FMU_ENDED } fmu_mode;

/* Variable. Its position in the table is its value reference less 1; reference 0 is time. */
typedef struct {
    size_t offset;
    uint32_t count;
    uint8_t type, role;
    bool strict; /* the value must be above low, not equal to it */
    double low, high;
    const char *name;
} fmu_variable;

typedef struct {
    int64_t now;  /* end of the last step, in 100 ns since the start */
    int64_t next; /* the next instant; for a vehicle, the last one */
    int64_t seen; /* time of the last command, for a vehicle */
} fmu_clock;

#include "model.h"

/* All data that change, without pointers: they are saved and restored as FMU state. */
typedef struct {
    model_data data;
    fmu_clock clock;
    double start;
    fmu_mode mode;
    bool begun;
} fmu_kept;

typedef struct fmu {
    fmu_kept kept;
    void (*say)(const struct fmu *f, const char *text);
    void *environment;    /* of the importer; passed to it with each message */
    void (*logger)(void); /* callback of FMI 3.0, stored under another type */
    char *name;
    void *workspace;
    char memory[MODEL_WORKSPACE + 64];
} fmu;

typedef struct {
    char token[sizeof MODEL_TOKEN];
    fmu_kept kept;
} fmu_snapshot;

static const size_t fmu_sizes[] = {sizeof(double), sizeof(float), 4, 8, 4, sizeof(bool)};

static void fmu_reset(fmu *f)
{
    memset(&f->kept, 0, sizeof f->kept);
    model_defaults(&f->kept.data);
    f->kept.clock.seen = FMU_UNSTAMPED;
}

static fmu *fmu_create(const char *name, const char *token, void *environment, void (*logger)(void),
                       void (*say)(const fmu *, const char *))
{
    fmu *const f = (fmu *)calloc(1, sizeof *f);
    if (!f)
        return NULL;
    f->say = say;
    f->environment = environment;
    f->logger = logger;
    f->workspace = f->memory + (64 - (uintptr_t)f->memory % 64) % 64;
    name = name ? name : "";
    f->name = (char *)malloc(strlen(name) + 1);
    if (f->name)
        strcpy(f->name, name);
    if (!f->name || !token || strcmp(token, MODEL_TOKEN)) {
        if (f->name)
            say(f, "the token is not that of this FMU's modelDescription.xml");
        free(f->name);
        free(f);
        return NULL;
    }
    fmu_reset(f);
    return f;
}

static void fmu_free(fmu *f)
{
    if (f)
        free(f->name);
    free(f);
}

/* Set the state at the start, from the present parameters. */
static void fmu_begin(fmu *f)
{
    if (f->kept.begun)
        return;
    f->kept.clock.now = f->kept.clock.next = 0;
    f->kept.clock.seen = FMU_UNSTAMPED;
    model_begin(&f->kept.data, &f->kept.clock, f->workspace);
    f->kept.begun = true;
}

static double fmu_read(const char *at, uint8_t type)
{
    double f64;
    float f32;
    int32_t i32;
    int64_t i64;
    uint32_t u32;
    bool flag;
    switch (type) {
    case FMU_F64: memcpy(&f64, at, sizeof f64); return f64;
    case FMU_F32: memcpy(&f32, at, sizeof f32); return f32;
    case FMU_I32: memcpy(&i32, at, sizeof i32); return i32;
    case FMU_I64: memcpy(&i64, at, sizeof i64); return (double)i64;
    case FMU_U32: memcpy(&u32, at, sizeof u32); return u32;
    default: memcpy(&flag, at, sizeof flag); return flag;
    }
}

/* Return false if the type cannot represent the value. */
static bool fmu_write(char *at, uint8_t type, double value)
{
    const double limits[][2] = {{0, 0}, {0, 0}, {-2147483648.0, 2147483647.0},
                                {-9223372036854775808.0, 9223372036854774784.0}, {0, 4294967295.0}, {0, 1}};
    if (type > FMU_F32 && !(value >= limits[type][0] && value <= limits[type][1]))
        return false;
    const float f32 = (float)value;
    const int32_t i32 = type == FMU_I32 ? (int32_t)value : 0;
    const int64_t i64 = type == FMU_I64 ? (int64_t)value : 0;
    const uint32_t u32 = type == FMU_U32 ? (uint32_t)value : 0;
    const bool flag = value != 0;
    switch (type) {
    case FMU_F64: memcpy(at, &value, sizeof value); break;
    case FMU_F32: memcpy(at, &f32, sizeof f32); break;
    case FMU_I32: memcpy(at, &i32, sizeof i32); break;
    case FMU_I64: memcpy(at, &i64, sizeof i64); break;
    case FMU_U32: memcpy(at, &u32, sizeof u32); break;
    default: memcpy(at, &flag, sizeof flag);
    }
    return true;
}

static bool fmu_fail(const fmu *f, const char *name, const char *problem)
{
    char text[400];
    snprintf(text, sizeof text, "%s: %s", name, problem);
    f->say(f, text);
    return false;
}

static const fmu_variable *fmu_find(const fmu *f, uint32_t reference)
{
    if (reference < 1 || reference > sizeof model_variables / sizeof model_variables[0]) {
        fmu_fail(f, "value reference", "there is no such variable");
        return NULL;
    }
    return &model_variables[reference - 1];
}

/* Return the address of a variable's value. For an unknown variable, report an error and return NULL. */
static const char *fmu_look(fmu *f, uint32_t reference, const fmu_variable **found)
{
    const fmu_variable *const v = *found = fmu_find(f, reference);
    if (!v)
        return NULL;
    if (v->role == FMU_OUTPUT && f->kept.mode == FMU_INITIALISING)
        fmu_begin(f);
    return (const char *)&f->kept.data + v->offset;
}

static bool fmu_may_set(const fmu *f, const fmu_variable *v)
{
    if (v->role == FMU_OUTPUT)
        return fmu_fail(f, v->name, "an output cannot be set");
    if (v->role == FMU_FIXED && f->kept.mode >= FMU_STEPPING)
        return fmu_fail(f, v->name, "a fixed parameter cannot be set after initialization");
    return true;
}

/* Check and set one number of a variable. A parameter must be within its range; an input may have any value. */
static bool fmu_set(fmu *f, const fmu_variable *v, uint32_t element, double value)
{
    if (v->role <= FMU_TUNABLE && !(value >= v->low && value <= v->high && !(v->strict && value <= v->low))) {
        char text[200];
        snprintf(text, sizeof text, "%.17g is not %s %.17g and at most %.17g", value, v->strict ? "above" : "at least",
                 v->low, v->high);
        return fmu_fail(f, v->name, text);
    }
    if (!fmu_write((char *)&f->kept.data + v->offset + element * fmu_sizes[v->type], v->type, value))
        return fmu_fail(f, v->name, "the variable's type cannot represent the value");
    if (f->kept.mode <= FMU_INITIALISING)
        f->kept.begun = false;
    return true;
}

static bool fmu_enter_initialization(fmu *f, double start)
{
    if (f->kept.mode != FMU_NEW || !isfinite(start))
        return fmu_fail(f, "initialization", "it must be entered once, before the first step, at a finite time");
    f->kept.start = start;
    f->kept.mode = FMU_INITIALISING;
    return true;
}

static bool fmu_exit_initialization(fmu *f)
{
    if (f->kept.mode != FMU_INITIALISING)
        return fmu_fail(f, "initialization", "it must be entered before it is exited");
    fmu_begin(f);
    f->kept.mode = FMU_STEPPING;
    return true;
}

static bool fmu_step(fmu *f, double from, double length)
{
    const double first = (from - f->kept.start) * FMU_TICKS, last = (from + length - f->kept.start) * FMU_TICKS;
    if (f->kept.mode != FMU_STEPPING)
        return fmu_fail(f, "step", "initialization must be finished first");
    if (!(length >= 0) || !(fabs(last) < 4e18))
        return fmu_fail(f, "step", "its length must be finite and at least 0");
    if (fabs(first - (double)f->kept.clock.now) > 1.0 + 1e-15 * fabs(first))
        return fmu_fail(f, "step", "it does not begin where the last one ended");
    const int64_t until = llround(last);
    model_advance(&f->kept.data, &f->kept.clock, until, f->workspace);
    f->kept.clock.now = until;
    return true;
}

static fmu_snapshot *fmu_save(const fmu *f, fmu_snapshot *into)
{
    fmu_snapshot *const s = into ? into : (fmu_snapshot *)malloc(sizeof *s);
    if (s) {
        memcpy(s->token, MODEL_TOKEN, sizeof s->token);
        memcpy(&s->kept, &f->kept, sizeof s->kept);
    }
    return s;
}

static bool fmu_restore(fmu *f, const fmu_snapshot *s)
{
    if (!s || memcmp(s->token, MODEL_TOKEN, sizeof s->token))
        return fmu_fail(f, "state", "it is not one of this FMU");
    memcpy(&f->kept, &s->kept, sizeof s->kept);
    return true;
}

static fmu_snapshot *fmu_deserialize(const fmu *f, const unsigned char *bytes, size_t size)
{
    fmu_snapshot *const s = size == sizeof *s ? (fmu_snapshot *)malloc(sizeof *s) : NULL;
    if (s)
        memcpy(s, bytes, size);
    if (s && !memcmp(s->token, MODEL_TOKEN, sizeof s->token))
        return s;
    free(s);
    fmu_fail(f, "state", "these bytes are not one of this FMU");
    return NULL;
}

#endif
