// As much of Gazebo's and ROS 2's headers as data/scenes/gz_joint.cpp and ros2_joint.cpp use.
#pragma once
#include <chrono>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace gz::math {
struct Vector3d {
    Vector3d(double x = 0, double y = 0, double z = 0);
    double &operator[](int), operator[](int) const;
    Vector3d operator+(const Vector3d &) const, operator-(const Vector3d &) const;
    Vector3d operator*(double) const, Cross(const Vector3d &) const;
};
struct Quaterniond {
    double W() const, X() const, Y() const, Z() const;
    Quaterniond Inverse() const, operator*(const Quaterniond &) const;
    Vector3d RotateVector(const Vector3d &) const, RotateVectorReverse(const Vector3d &) const;
};
struct Pose3d {
    const Vector3d &Pos() const;
    const Quaterniond &Rot() const;
    Pose3d operator*(const Pose3d &) const;
};
struct Matrix3d {
    Matrix3d Inverse() const;
    Vector3d operator*(const Vector3d &) const;
};
struct MassMatrix3d { double Mass() const; };
struct Inertiald {
    const Pose3d &Pose() const;
    const MassMatrix3d &MassMatrix() const;
};
}  // namespace gz::math
namespace sdf {
struct Element {
    template <class T> T Get(const std::string &) const;
    template <class T> std::pair<T, bool> Get(const std::string &, const T &) const;
};
}  // namespace sdf
namespace gz::sim {
using Entity = unsigned long;
struct EntityComponentManager {};
struct EventManager {};
struct UpdateInfo {
    std::chrono::steady_clock::duration dt;
    bool paused;
};
struct System { virtual ~System(); };
struct ISystemConfigure {
    virtual void Configure(const Entity &, const std::shared_ptr<const sdf::Element> &,
                           EntityComponentManager &, EventManager &) = 0;
};
struct ISystemPreUpdate {
    virtual void PreUpdate(const UpdateInfo &, EntityComponentManager &) = 0;
};
struct Link {
    using Ecm = const EntityComponentManager &;
    explicit Link(Entity = 0);
    bool Valid(Ecm) const;
    std::optional<math::Pose3d> WorldPose(Ecm) const;
    std::optional<math::Vector3d> WorldAngularVelocity(Ecm) const, WorldLinearVelocity(Ecm) const;
    std::optional<math::Vector3d> WorldLinearVelocity(Ecm, const math::Vector3d &) const;
    std::optional<math::Inertiald> WorldInertial(Ecm) const;
    std::optional<math::Matrix3d> WorldInertiaMatrix(Ecm) const;
    void EnableVelocityChecks(EntityComponentManager &, bool = true) const;
    void AddWorldWrench(EntityComponentManager &, const math::Vector3d &, const math::Vector3d &) const;
};
struct Model {
    explicit Model(Entity);
    Entity LinkByName(const EntityComponentManager &, const std::string &) const;
};
}  // namespace gz::sim
#define GZ_ADD_PLUGIN(...)
#define RCLCPP_ERROR(...)

struct Vector { double x, y, z; };
struct Quaternion { double x, y, z, w; };
namespace geometry_msgs::msg {
struct WrenchStamped {
    int header;
    struct { Vector force, torque; } wrench;
};
}  // namespace geometry_msgs::msg
namespace nav_msgs::msg {
struct Odometry {
    int header;
    struct { struct { Vector position; Quaternion orientation; } pose; } pose;
    struct { struct { Vector linear, angular; } twist; } twist;
};
}  // namespace nav_msgs::msg
namespace rclcpp {
template <class T> struct Publisher {
    using SharedPtr = std::shared_ptr<Publisher>;
    void publish(const T &);
};
template <class T> struct Subscription { using SharedPtr = std::shared_ptr<Subscription>; };
struct Node {
    explicit Node(const std::string &);
    template <class T> T declare_parameter(const std::string &, const T &);
    template <class T> typename Publisher<T>::SharedPtr create_publisher(const std::string &, int);
    template <class T, class F>
    typename Subscription<T>::SharedPtr create_subscription(const std::string &, int, F &&) { return {}; }
    int get_logger() const;
};
void init(int, char **);
void spin(std::shared_ptr<Node>);
void shutdown();
}  // namespace rclcpp
