#include "loop.h"

#include "controller.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

typedef int (*SetReal)(void *, const uint32_t *, size_t, const double *);
typedef int (*GetReal)(void *, const uint32_t *, size_t, double *);
typedef int (*DoStep2)(void *, double, double, int);
typedef int (*SetFloat64)(void *, const uint32_t *, size_t, const double *, size_t);
typedef int (*GetFloat64)(void *, const uint32_t *, size_t, double *, size_t);
typedef int (*DoStep3)(void *, double, double, bool, bool *, bool *, bool *, double *);

/* Of both versions: above this a call has failed. */
enum { STATUS_WARNING = 1 };
/* A status that no version has: a step that the importer has more to do with than this loop knows. */
enum { STATUS_NEEDS_IMPORTER = 100 };

static int set_inputs(const PlantCalls *plant, const double u[])
{
    const size_t n = (size_t)plant->n_inputs;
    if (plant->version == 2) return ((SetReal)plant->set_values)(plant->instance, plant->inputs, n, u);
    return ((SetFloat64)plant->set_values)(plant->instance, plant->inputs, n, u, n);
}

static int get_outputs(const PlantCalls *plant, double y[])
{
    const size_t n = (size_t)plant->n_outputs;
    if (plant->version == 2) return ((GetReal)plant->get_values)(plant->instance, plant->outputs, n, y);
    return ((GetFloat64)plant->get_values)(plant->instance, plant->outputs, n, y, n);
}

static int do_step(const PlantCalls *plant, double time)
{
    if (plant->version == 2) return ((DoStep2)plant->do_step)(plant->instance, time, plant->step_size, 1);
    bool event = false, terminate = false, early = false;
    double reached = time;
    const int status = ((DoStep3)plant->do_step)(plant->instance, time, plant->step_size, true, &event, &terminate,
                                                 &early, &reached);
    return status <= STATUS_WARNING && (event || terminate || early) ? STATUS_NEEDS_IMPORTER : status;
}

static void apply(const Effect effects[], int64_t n, double values[], size_t k)
{
    for (int64_t i = 0; i < n; ++i) {
        double *value = values + effects[i].signal;
        *value = condition_effect(effects[i].kind, *value, effects[i].given, effects[i].memory, k);
    }
}

static void choose_values(const double values[], const int64_t places[], int64_t n, double chosen[])
{
    for (int64_t i = 0; i < n; ++i) chosen[i] = values[places[i]];
}

static bool all_finite(const double values[], int64_t n)
{
    for (int64_t i = 0; i < n; ++i) {
        if (!isfinite(values[i])) return false;
    }
    return true;
}

/* Replace what is lost, NaN, by what was seen last if that stands in; return whether it does. */
static bool take_seen(const Loop *loop, double seen[])
{
    bool lost = false;
    for (int64_t i = 0; i < loop->n_sensed; ++i) {
        if (!isnan(seen[i])) continue;
        lost = true;
        if (loop->loses == 2) seen[i] = loop->last_seen[i];
    }
    memcpy(loop->last_seen, seen, (size_t)loop->n_sensed * sizeof(double));
    return lost && loop->loses == 2;
}

/* Take the disturbances as they are seen: in place of what is lost stands the last value, or the actual one. */
static void see_disturbances(const Loop *loop, int64_t row, const double seen[], const double actual[])
{
    double *const now = loop->d + row * loop->n_disturbances;
    for (int64_t i = 0; i < loop->n_disturbances; ++i) {
        const int64_t place = loop->disturbances[i];
        now[i] = !isnan(seen[place]) ? seen[place] : row > 0 ? now[i - loop->n_disturbances] : actual[place];
    }
}

/* Return the references from a row on, and after them what else a controller sees there. */
static const double *look_ahead(const Loop *loop, int64_t row, const double y[], double r[])
{
    const double *const reference = loop->reference + row * loop->p;
    if (!loop->further) return reference;
    const int64_t rows = 1 + loop->preview, n = rows * loop->p;
    memcpy(r, reference, (size_t)n * sizeof(double));
    double *const further = r + n;
    memcpy(further, loop->further + row * loop->n_further, (size_t)loop->n_further * sizeof(double));
    for (int64_t i = 0; i < loop->n_told; ++i) {
        const int64_t place = loop->told[i], lag = loop->lags[place];
        further[i] = loop->d[(row > lag ? row - lag : 0) * loop->n_disturbances + place];
    }
    for (int64_t i = 0; loop->band >= 0 && i < n; ++i) { /* of a band the point that is nearest */
        const double *const edges = further + loop->band + 2 * i;
        if (isfinite(y[i % loop->p])) r[i] = fmin(fmax(y[i % loop->p], edges[0]), edges[1]);
    }
    return r;
}

/* Keep outputs that are read between samples; a disturbance is held over the sampling interval. */
static void keep_between(const Loop *loop, int64_t row, size_t k, int64_t reading)
{
    double *const kept = loop->between + (row * (loop->readings - 1) + reading) * loop->n_read;
    for (int64_t i = 0; i < loop->n_read; ++i) {
        const int64_t place = loop->read[i];
        const double *const added = loop->output_disturbance;
        kept[i] = loop->plant_outputs[place] + (added ? added[k * (size_t)loop->n_sensed + (size_t)place] : 0.0);
    }
}

int64_t loop_run(const Loop *loop, Progress *progress)
{
    const PlantCalls *plant = &loop->plant;
    const size_t n = (size_t)loop->n_sensed, n_outputs = (size_t)plant->n_outputs;
    double *const actual = loop->scratch, *const seen = actual + n, *const known = seen + n;
    double *const inputs = known + n, *const r = inputs + plant->n_inputs;
    progress->rows = loop->begin;
    progress->steps = plant->steps;
    progress->plant_status = 0;
    for (int64_t row = loop->begin; row < loop->end; ++row) {
        const int64_t sample = loop->first + row;
        const size_t k = (size_t)sample;
        memcpy(actual, loop->plant_outputs, n_outputs * sizeof(double));
        for (size_t i = n_outputs; i < n; ++i) actual[i] = loop->courses[k * (n - n_outputs) + i - n_outputs];
        if (loop->output_disturbance) {
            for (size_t i = 0; i < n; ++i) actual[i] += loop->output_disturbance[k * n + i];
        }
        memcpy(seen, actual, n * sizeof(double));
        apply(loop->before_noise, loop->n_before_noise, seen, k);
        for (int64_t i = 0; i < loop->n_noise; ++i) seen[i] += loop->noise[row * loop->n_noise + i];
        apply(loop->after_noise, loop->n_after_noise, seen, k);
        unsigned status = loop->loses && take_seen(loop, seen) ? STATUS_OLDER : 0;

        choose_values(actual, loop->outputs, loop->p, loop->y + row * loop->p);
        double *const measured = loop->measurements + row * loop->q;
        choose_values(seen, loop->measured, loop->q, measured);
        if (loop->d) see_disturbances(loop, row, seen, actual);
        if (loop->actual) memcpy(loop->actual + row * loop->n_sensed, actual, n * sizeof(double));
        if (loop->seen) choose_values(seen, loop->outputs, loop->p, loop->seen + row * loop->p);
        progress->rows = row + 1;

        double *const u = loop->u + row * loop->m;
        memset(u, 0, (size_t)loop->m * sizeof(double));
        if (loop->controller) {
            choose_values(seen, loop->outputs, loop->p, known);
            choose_values(measured, loop->others, loop->n_others, known + loop->p);
            status |= controller_step(loop->controller, known, look_ahead(loop, row, known, r), u);
        }
        double *const moved = inputs; /* the driven inputs come first, and then go to their places */
        for (int64_t i = 0; i < loop->m; ++i) {
            if (loop->commands) u[i] += loop->commands[row * loop->m + i];
            u[i] = fmin(fmax(u[i], loop->low[row * loop->m + i]), loop->high[row * loop->m + i]);
            moved[i] = u[i];
        }
        apply(loop->actuators, loop->n_actuators, moved, k);
        if (loop->input_disturbance) {
            for (int64_t i = 0; i < loop->m; ++i) moved[i] += loop->input_disturbance[sample * loop->m + i];
        }
        for (int64_t i = loop->m - 1; i >= 0; --i) inputs[loop->driven[i]] = moved[i];
        for (int64_t i = 0; i < loop->n_own; ++i) {
            inputs[loop->own[i]] = loop->own_inputs[sample * loop->n_own + i];
        }
        choose_values(inputs, loop->changed, loop->n_changed, loop->applied + row * loop->n_changed);
        if (loop->given) memcpy(loop->given + row * plant->n_inputs, inputs, (size_t)plant->n_inputs * sizeof(double));
        loop->status[row] = status;

        if (row + 1 == loop->end && !loop->holds_last) break;
        int failed = set_inputs(plant, inputs);
        for (int64_t reading = 1; reading <= loop->readings; ++reading) {
            for (int64_t i = 0; failed <= STATUS_WARNING && i < plant->steps_at_once; ++i) {
                failed = do_step(plant, plant->base_time + (double)progress->steps * plant->step_size);
                if (failed <= STATUS_WARNING) ++progress->steps;
            }
            if (failed <= STATUS_WARNING) failed = get_outputs(plant, loop->plant_outputs);
            if (failed > STATUS_WARNING) {
                progress->plant_status = failed;
                return LOOP_PLANT_FAILED;
            }
            if (!all_finite(loop->plant_outputs, plant->n_outputs)) return LOOP_NOT_FINITE;
            if (loop->between && reading < loop->readings) keep_between(loop, row, k, reading - 1);
        }
    }
    return LOOP_DONE;
}

size_t loop_controller_size(void)
{
    return sizeof(ControllerState);
}

void loop_start_controller(void *state, const double numbers[])
{
#ifdef CONTROLLER_LOADS
    controller_load(numbers);
#else
    (void)numbers;
#endif
    controller_start(state);
}
