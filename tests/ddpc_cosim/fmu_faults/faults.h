/* An integrator y' = u that misbehaves: which fault, and when, are its parameters. */
#ifndef FAULTS_H
#define FAULTS_H

typedef enum {
    NO_FAULT,
    RETURN_ERROR,
    RETURN_FATAL,
    RETURN_DISCARD,
    DISCARD_AND_TERMINATE,
    RETURN_NAN,
    RETURN_INFINITY,
    SEGMENTATION_FAULT,
    CALL_ABORT,
    CALL_EXIT,
    OVERFLOW_STACK,
    HANG_IN_STEP,
    HANG_IN_INITIALIZATION,
    HANG_IN_TERMINATE,
    CRASH_IN_INITIALIZATION,
    CRASH_IN_TERMINATE,
    FLOOD_LOG,
    FLOOD_STDOUT,
    FLOOD_STDERR,
    FLOOD_DESCRIPTOR,
    LEAVE_A_FILE,
    PRINT_AND_ABORT,
} Fault;

typedef struct {
    double u, y, fault_time;
    int fault;
    int wants_termination;
    void (*log)(void *environment, const char *message);
    void *environment;
} Model;

typedef enum { STEP, INITIALIZATION, TERMINATE } Phase;

/* Do in this phase what the fault asks for; return the status, as FMI counts them. */
int misbehave(Model *model, Phase phase);

/* Integrate over a step; return the status. */
int step(Model *model, double time, double size);

#endif
