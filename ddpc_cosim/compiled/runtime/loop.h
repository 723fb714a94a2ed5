/* A closed loop, sample by sample: what loop/master.py and conditions/ do in Python.
 *
 * The plant is an initialised FMU for Co-Simulation, whose functions are called by their addresses. All tables have
 * rows of samples; those of a run that goes on in several calls are the same in each. */
#ifndef LOOP_H
#define LOOP_H

#include <stddef.h>
#include <stdint.h>

#ifdef _WIN32
#define LOOP_EXPORT __declspec(dllexport)
#else
#define LOOP_EXPORT __attribute__((visibility("default")))
#endif

/* An FMU: its functions of FMI 2.0 or 3.0, its instance, the value references of what is driven and read. */
typedef struct {
    int64_t version;
    void *set_values;
    void *do_step;
    void *get_values;
    void *instance;
    const uint32_t *inputs;
    const uint32_t *outputs;
    int64_t n_inputs;
    int64_t n_outputs;
    double base_time; /* step i begins at base_time + i * step_size */
    double step_size;
    int64_t steps; /* done so far */
    int64_t steps_at_once; /* between two readings of the outputs */
} PlantCalls;

/* What one condition does to one signal. */
typedef struct {
    int64_t kind; /* as condition_effect numbers them */
    int64_t signal;
    double given;
    double *memory;
} Effect;

typedef struct {
    PlantCalls plant;
    int64_t begin, end; /* rows */
    int64_t first;      /* row k is sample first + k since the plant was set up */
    int64_t holds_last; /* whether the plant holds the inputs of the last row, too */

    int64_t p, q, m;         /* controlled outputs, measurements, driven inputs */
    const int64_t *outputs;  /* p places among the plant's outputs */
    const int64_t *measured; /* q of them */
    const int64_t *others;   /* of measurements that are not controlled, among the q */
    int64_t n_others;
    const int64_t *driven;   /* m places among the plant's inputs */
    const int64_t *changed;  /* of inputs whose applied values are kept, among all */
    int64_t n_changed;

    const Effect *actuators;
    int64_t n_actuators;
    const double *input_disturbance; /* (K, m), or NULL */
    const double *own_inputs;        /* (K, others): inputs that no controller drives, in order, or NULL */
    const int64_t *own;              /* their places among all */
    int64_t n_own;

    /* Signals that sensors see: the plant's outputs, and inputs that are known disturbances. */
    int64_t n_sensed;
    const double *courses;            /* (K, n_sensed - n_outputs): of these inputs, or NULL */
    const double *output_disturbance; /* (K, n_sensed), or NULL */
    const Effect *before_noise;
    int64_t n_before_noise;
    const double *noise; /* (rows, n_noise), or NULL */
    int64_t n_noise;
    const Effect *after_noise;
    int64_t n_after_noise;
    int64_t loses; /* 0: nothing; 1: what is lost is NaN; 2: the last value stands in */

    const double *commands;  /* (rows, m) added to the inputs of the controller; or NULL */
    void *controller;        /* its state; or NULL: there is none */
    const double *reference; /* (rows + preview, p) */
    int64_t preview;         /* future references that the controller sees */
    int64_t band;            /* where among `further` the edges of bands begin, now and then ahead; -1: no bands */
    const double *further;   /* (rows, n_further): what follows the references in `r` of a step; or NULL */
    int64_t n_further;
    const int64_t *disturbances; /* n_disturbances places among the signals that are sensed */
    int64_t n_disturbances;
    const int64_t *lags;     /* by how many samples each is measured late */
    const int64_t *told;     /* of those that the controller is told, which `further` begins with */
    int64_t n_told;
    const double *low;       /* (rows, m) limits of the inputs */
    const double *high;

    int64_t readings;        /* of the outputs in a sampling interval */
    const int64_t *read;     /* n_read places among the outputs that are kept of those between samples */
    int64_t n_read;

    double *plant_outputs; /* n_outputs, now; the last ones in the end */
    double *last_seen;     /* n_sensed: as they were seen at the last sample */
    double *scratch;       /* 3 * n_sensed + n_inputs + (1 + preview) * p + n_further */

    double *y;          /* (rows, p) */
    double *seen;       /* (rows, p): as the controller sees it; or NULL */
    double *measurements; /* (rows, q) */
    double *u;          /* (rows, m) */
    double *applied;    /* (rows, n_changed) */
    double *d;          /* (rows, n_disturbances): as seen then, the last value for a lost one; or NULL */
    double *actual;     /* (rows, n_sensed): as they were; or NULL */
    double *between;    /* (rows, readings - 1, n_read): NaN where the plant has not been; or NULL */
    double *given;      /* (rows, n_inputs): what the plant was given; or NULL */
    uint32_t *status;   /* rows */
} Loop;

enum { LOOP_DONE, LOOP_PLANT_FAILED, LOOP_NOT_FINITE };

typedef struct {
    int64_t rows;        /* begun */
    int64_t steps;       /* of the plant, done */
    int64_t plant_status;
} Progress;

/* In the status of a row, besides those of the controller: a lost measurement for which the last one stands in. */
#define STATUS_OLDER 0x80000000u

LOOP_EXPORT int64_t loop_run(const Loop *loop, Progress *progress);
LOOP_EXPORT size_t loop_controller_size(void);
LOOP_EXPORT void loop_start_controller(void *state, const double numbers[]);

/* What a condition makes of a value of one signal at sample k; generated from the conditions that are installed. */
double condition_effect(int64_t kind, double value, double given, double memory[], size_t k);

#endif
