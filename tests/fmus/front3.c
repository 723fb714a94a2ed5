/* FMI 3.0, Model Exchange and Co-Simulation; what a run does not need is left out on purpose. */
#include "models.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef void (*Log)(void *environment, int status, const char *category, const char *message);

static void pass_on(const Logging *logging, int status, const char *message)
{
    ((Log)logging->callback)(logging->environment, status, "logAll", message);
}
static void *instantiate(const char *token, void *environment, Log log)
{
    return create(token, (Logging){log ? pass_on : NULL, (const void *)log, environment});
}
EXPORT void *fmi3InstantiateModelExchange(const char *name, const char *token, const char *resources, bool visible,
                                          bool logging, void *environment, Log log)
{
    return instantiate(token, environment, log);
}
EXPORT void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible,
                                         bool logging, bool event_mode, bool early_return, const unsigned required[],
                                         size_t n, void *environment, Log log, void *update)
{
    Model *m = instantiate(token, environment, log);
    if (!m)
        return NULL;
    m->has_event_mode = event_mode && (m->kind == FEED || m->kind == CLOCKED);
    if (m->values[FAULT] != NO_CO_SIMULATION && (m->values[FAULT] != NEEDS_EVENT_MODE || event_mode))
        return m;
    destroy(m);
    return NULL;
}
EXPORT void fmi3FreeInstance(void *c) { destroy(c); }
EXPORT int fmi3EnterConfigurationMode(void *c)
{
    ((Model *)c)->configuring = true;
    return 0;
}
EXPORT int fmi3ExitConfigurationMode(void *c)
{
    ((Model *)c)->configuring = false;
    return 0;
}
EXPORT int fmi3EnterInitializationMode(void *c, bool tolerance_defined, double tolerance, double start,
                                       bool stop_defined, double stop)
{
    return set_up(c, start, stop_defined ? stop : INFINITY);
}
EXPORT int fmi3ExitInitializationMode(void *c)
{
    initialise(c);
    return 0;
}
EXPORT int fmi3Terminate(void *c) { return terminate(c); }

/* FEED has variables of every type; the other models' are real in their own view. */
#define ACCESS(Type, c_type, member)                                                                               \
    EXPORT int fmi3Set##Type(void *c, const unsigned vr[], size_t n, const c_type value[], size_t count)           \
    {                                                                                                              \
        Model *m = c;                                                                                              \
        for (size_t i = 0; i < n && m->kind == FEED; i++) {                                                        \
            if ((vr[i] == FEED_SIZE) != m->configuring)                                                            \
                return ERROR;                                                                                      \
            for (size_t j = 0; j < feed_length(m, vr[i]); j++)                                                     \
                m->feed[vr[i]][j].member = *value++;                                                               \
        }                                                                                                          \
        for (size_t i = 0; i < n && m->kind != FEED; i++) {                                                        \
            double real = (double)value[i];                                                                        \
            int status = set_reals(m, &vr[i], 1, &real);                                                           \
            if (status != OK && status != WARNING)                                                                 \
                return status;                                                                                     \
        }                                                                                                          \
        return OK;                                                                                                 \
    }                                                                                                              \
    EXPORT int fmi3Get##Type(void *c, const unsigned vr[], size_t n, c_type value[], size_t count)                 \
    {                                                                                                              \
        Model *m = c;                                                                                              \
        const c_type *begin = value;                                                                               \
        for (size_t i = 0; i < n; i++) {                                                                           \
            double real = 0.0;                                                                                     \
            int status = m->kind == FEED ? OK : get_reals(m, &vr[i], 1, &real);                                    \
            if (status != OK)                                                                                      \
                return status;                                                                                     \
            for (size_t j = 0; m->kind == FEED && j < feed_length(m, vr[i]); j++)                                  \
                *value++ = m->feed[vr[i]][j].member;                                                               \
            if (m->kind != FEED)                                                                                   \
                *value++ = (c_type)real;                                                                           \
        }                                                                                                          \
        return (size_t)(value - begin) == count ? OK : ERROR;                                                      \
    }

ACCESS(Float64, double, f64)
ACCESS(Float32, float, f32)
ACCESS(Int64, int64_t, i64)
ACCESS(Int32, int32_t, i32)
ACCESS(UInt64, uint64_t, i64)
ACCESS(Int16, int16_t, i16)
ACCESS(Int8, int8_t, i8)
ACCESS(Boolean, bool, b)

EXPORT int fmi3SetString(void *c, const unsigned vr[], size_t n, const char *const value[], size_t count)
{
    ((Model *)c)->values[NAME_LENGTH] = (double)strlen(value[0]);
    return 0;
}

EXPORT int fmi3DoStep(void *c, double time, double h, bool no_set_state, bool *event, bool *terminate, bool *early,
                      double *reached)
{
    Model *m = c;
    int status = step(m, time, h);
    *event = false;
    *terminate = m->terminate;
    if (m->values[FAULT] == ASK_TO_TERMINATE && status == DISCARD)
        status = OK; /* FMI 3.0 has a flag for it */
    *early = m->kind == FEED && h > 0.35; /* a long step returns halfway */
    *reached = *early ? time + h / 2 : m->time;
    return status;
}

EXPORT int fmi3EnterEventMode(void *c)
{
    ((Model *)c)->in_event_mode = true;
    return 0;
}
EXPORT int fmi3EnterStepMode(void *c)
{
    ((Model *)c)->in_event_mode = false;
    return 0;
}
EXPORT int fmi3EnterContinuousTimeMode(void *c)
{
    ((Model *)c)->in_event_mode = false;
    return 0;
}
EXPORT int fmi3SetClock(void *c, const unsigned vr[], size_t n, const bool value[])
{
    Model *m = c;
    for (size_t i = 0; i < n; i++) {
        if (!m->in_event_mode || vr[i] != CLOCK || !value[i])
            return ERROR;
        m->ticks++;
    }
    return 0;
}
EXPORT int fmi3UpdateDiscreteStates(void *c, bool *again, bool *terminate, bool *nominals, bool *values,
                                    bool *next_defined, double *next)
{
    Model *m = c;
    *values = handle_event(m);
    *again = m->kind == FEED && m->updates++ % 2 == 0; /* every event takes two updates */
    *nominals = false;
    *terminate = m->terminate;
    *next_defined = m->next_event >= 0.0;
    *next = m->next_event;
    return 0;
}
EXPORT int fmi3GetFMUState(void *c, void **state)
{
    *state = saved(c);
    return 0;
}
EXPORT int fmi3SetFMUState(void *c, void *state)
{
    restore(c, state);
    return 0;
}
EXPORT int fmi3FreeFMUState(void *c, void **state)
{
    free(*state);
    *state = NULL;
    return 0;
}
#ifdef KEEPING
EXPORT int fmi3SerializedFMUStateSize(void *c, void *state, size_t *size)
{
    *size = state_size(state);
    return 0;
}
EXPORT int fmi3SerializeFMUState(void *c, void *state, unsigned char bytes[], size_t size)
{
    memset(bytes, 0, size);
    memcpy(bytes, state, sizeof(Model));
    return 0;
}
EXPORT int fmi3DeserializeFMUState(void *c, const unsigned char bytes[], size_t size, void **state)
{
    return deserialised(c, bytes, size, state);
}
#endif
EXPORT int fmi3CompletedIntegratorStep(void *c, bool no_set_state, bool *event, bool *terminate)
{
    *event = completed_step(c);
    *terminate = ends_after_step(c);
    return 0;
}
EXPORT int fmi3SetTime(void *c, double time)
{
    ((Model *)c)->time = time;
    return 0;
}
EXPORT int fmi3SetContinuousStates(void *c, const double x[], size_t n)
{
    memcpy(&((Model *)c)->values[X], x, n * sizeof *x);
    return 0;
}
EXPORT int fmi3GetContinuousStates(void *c, double x[], size_t n)
{
    memcpy(x, &((Model *)c)->values[X], n * sizeof *x);
    return 0;
}
EXPORT int fmi3GetNominalsOfContinuousStates(void *c, double x[], size_t n)
{
    for (size_t i = 0; i < n; i++)
        x[i] = 1.0;
    return 0;
}
EXPORT int fmi3GetContinuousStateDerivatives(void *c, double dx[], size_t n)
{
    return derivatives(c, dx);
}
EXPORT int fmi3GetEventIndicators(void *c, double z[], size_t n)
{
    event_indicators(c, z);
    return 0;
}
