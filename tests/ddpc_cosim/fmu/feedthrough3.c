/* FMI 3.0 Co-Simulation: variables of every type; at a step, reference r + 100 becomes what reference r is.
   References 20 to 29 are arrays whose length is the structural parameter 1; reference 30 is a 2 x 3 matrix. */
#include "models.h"

#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { REFERENCES = 200, LONGEST = 16, SIZE = 1 };

typedef union { double f64; float f32; int64_t i64; int32_t i32; int16_t i16; int8_t i8; bool b; } Value;
typedef struct {
    Value values[REFERENCES][LONGEST];
    bool configuring, event_mode, in_events;
    int events;
} Feed;

static size_t length(const Feed *f, unsigned reference)
{
    unsigned r = reference % 100;
    return r == 30 ? 6 : r >= 20 && r < 30 ? (size_t)f->values[SIZE][0].i64 : 1;
}

EXPORT void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                         bool logging, bool event_mode, bool early_return, const unsigned required[],
                                         size_t n, void *environment, void *log, void *update)
{
    Feed *f = calloc(1, sizeof *f);
    f->values[SIZE][0].i64 = 2;
    f->event_mode = event_mode;
    return f;
}
EXPORT void fmi3FreeInstance(void *c) { free(c); }
EXPORT int fmi3EnterConfigurationMode(void *c)
{
    ((Feed *)c)->configuring = true;
    return 0;
}
EXPORT int fmi3ExitConfigurationMode(void *c)
{
    ((Feed *)c)->configuring = false;
    return 0;
}
EXPORT int fmi3EnterInitializationMode(void *c, bool td, double t, double start, bool sd, double stop) { return 0; }
EXPORT int fmi3ExitInitializationMode(void *c)
{
    ((Feed *)c)->in_events = ((Feed *)c)->event_mode;
    return 0;
}
EXPORT int fmi3EnterEventMode(void *c)
{
    ((Feed *)c)->in_events = true;
    return 0;
}
EXPORT int fmi3EnterStepMode(void *c)
{
    ((Feed *)c)->in_events = false;
    return 0;
}
EXPORT int fmi3UpdateDiscreteStates(void *c, bool *again, bool *terminate, bool *nominals, bool *values,
                                    bool *next_defined, double *next)
{
    *again = ((Feed *)c)->events++ % 2 == 0; /* every event takes two updates */
    *terminate = *nominals = *values = *next_defined = false;
    return 0;
}
EXPORT int fmi3Terminate(void *c) { return 0; }
EXPORT int fmi3DoStep(void *c, double time, double h, bool no_set_state, bool *event, bool *terminate, bool *early,
                      double *reached)
{
    Feed *f = c;
    if (f->in_events)
        return 3;
    memcpy(f->values[100], f->values[0], 99 * sizeof f->values[0]);
    f->values[199][0].f64 += 1.0; /* how many steps */
    *event = *terminate = false;
    *early = h > 0.35; /* a long step returns halfway */
    *reached = *early ? time + h / 2 : time + h;
    return 0;
}

#define ACCESS(Type, c_type, member)                                                                               \
    EXPORT int fmi3Set##Type(void *c, const unsigned vr[], size_t n, const c_type value[], size_t count)          \
    {                                                                                                              \
        Feed *f = c;                                                                                               \
        for (size_t i = 0; i < n; i++) {                                                                           \
            if ((vr[i] == SIZE) != f->configuring)                                                                 \
                return 3;                                                                                          \
            for (size_t j = 0; j < length(f, vr[i]); j++)                                                          \
                f->values[vr[i]][j].member = *value++;                                                             \
        }                                                                                                          \
        return 0;                                                                                                  \
    }                                                                                                              \
    EXPORT int fmi3Get##Type(void *c, const unsigned vr[], size_t n, c_type value[], size_t count)                \
    {                                                                                                              \
        Feed *f = c;                                                                                               \
        const c_type *begin = value;                                                                               \
        for (size_t i = 0; i < n; i++)                                                                             \
            for (size_t j = 0; j < length(f, vr[i]); j++)                                                          \
                *value++ = f->values[vr[i]][j].member;                                                             \
        return (size_t)(value - begin) == count ? 0 : 3;                                                           \
    }

ACCESS(Float64, double, f64)
ACCESS(Float32, float, f32)
ACCESS(Int64, int64_t, i64)
ACCESS(Int32, int32_t, i32)
ACCESS(UInt64, uint64_t, i64)
ACCESS(Int16, int16_t, i16)
ACCESS(Int8, int8_t, i8)
ACCESS(Boolean, bool, b)
